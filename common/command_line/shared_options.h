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

/// For files and folders of results: what is wrong with the place is told before the work. "-" is standard output.
///   check  check_output_file or check_output_folder
CLI::Validator place_for(Result<void> (*check)(const std::string& path));

}  // namespace eigencast
