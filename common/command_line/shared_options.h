// SPDX-License-Identifier: MIT
#pragma once

#include <string>

#include "common/core/result.h"
#include "common/net/url.h"

namespace CLI {
class App;
class Option;
class Validator;
}  // namespace CLI

/// Options that several programs have, alike in name and meaning.
namespace eigencast {

/// --token, --ca, --cert, --key and --insecure. Gives --token, for what a program says of it beyond that.
CLI::Option* add_credential_options(CLI::App& app, Credentials& credentials);

/// --help-all: the help of every command, nested ones too; manual pages are made from it. Call before commands are added.
void add_help_all(CLI::App& app);

/// What is wrong with numbers that a command line gave and CLI11 takes: "nan" lies in no range, and in every one by its
/// comparisons. Empty: nothing. REQUIRES: `app` has parsed.
std::string fault_of_numbers(const CLI::App& app);

/// For files and folders of results: errors are reported before the work. "-" is standard output.
///   check  check_output_file or check_output_folder
CLI::Validator output_path(Result<void> (*check)(const std::string& path));

}  // namespace eigencast
