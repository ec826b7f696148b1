// SPDX-License-Identifier: MIT
#pragma once

#include <CLI/CLI.hpp>
#include <string>

#include "common/command_line/command_line.h"
#include "sender/commands.h"

/// Options that several commands have, by what they fill.
namespace eigencast {

/// A finite number above 0.
CLI::Validator positive();

void add_clip_options(CLI::App& app, SourceOptions& source);
/// BasisKind and int, or vectors of them to compare.
template <typename Bases, typename Ranks>
void add_basis_options(CLI::App& app, Bases& bases, Ranks& ranks, SourceOptions& source);
void add_asset_options(CLI::App& app, SourceOptions& source);
void add_bake_options(CLI::App& app, SourceOptions& source);
void add_source_options(CLI::App& app, SourceOptions& source);

/// A number from `low` to `high`.
template <typename T>
CLI::Option* bounded(CLI::App& app, const char* names, T& value, const char* help, double low, double high) {
  return app.add_option(names, value, help)->check(CLI::Range(low, high));
}

/// double, or a vector to compare. Gives the option of the error.
template <typename Errors>
CLI::Option* add_codec_options(CLI::App& app, std::string& codec, Errors& errors);
void add_target_options(CLI::App& app, TargetOptions& target);
void add_memory_option(CLI::App& app, TargetOptions& target);
/// add_codec_options(), add_memory_option(), and what else codes a clip's poses.
void add_coding_options(CLI::App& app, TargetOptions& target);

}  // namespace eigencast
