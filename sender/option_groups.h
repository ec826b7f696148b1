// SPDX-License-Identifier: MIT
#pragma once

#include <string>

#include "common/command_line/shared_options.h"
#include "sender/commands.h"

/// Options that several commands have, by what they fill.
namespace eigencast {

/// A finite number above 0.
CLI::Validator positive();

/// Which clip, without how it is baked.
void add_clip_options(CLI::App& app, SourceOptions& source);
/// One basis and rank (BasisKind, int) or, to compare them, several of each (vectors).
template <typename Bases, typename Ranks>
void add_basis_options(CLI::App& app, Bases& bases, Ranks& ranks, SourceOptions& source);
/// What a bake takes beside basis and rank.
void add_asset_options(CLI::App& app, SourceOptions& source);
/// All that a bake takes, of one basis.
void add_bake_options(CLI::App& app, SourceOptions& source);
/// Which clip, and how it is baked.
void add_source_options(CLI::App& app, SourceOptions& source);

/// One error (double) or, to compare them, several (a vector). Gives the option of the error.
template <typename Errors>
CLI::Option* add_codec_options(CLI::App& app, std::string& codec, Errors& errors);
/// Where to.
void add_target_options(CLI::App& app, TargetOptions& target);
/// How the poses that are made here are coded and sent.
void add_coding_options(CLI::App& app, TargetOptions& target);

}  // namespace eigencast
