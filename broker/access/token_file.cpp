// SPDX-License-Identifier: MIT
#include "broker/access/token_file.h"

#include <openssl/rand.h>

#include <algorithm>
#include <optional>
#include <set>

#include "common/core/files.h"
#include "common/core/text.h"

namespace eigencast::broker {
namespace {

constexpr std::string_view kHash = "sha256:";
constexpr std::string_view kMark = "ect_";  ///< Leaked tokens can be found by a search.
constexpr std::size_t kMaxNameBytes = 64;
constexpr std::size_t kMaxFileBytes = 16 << 20;

bool is_name(std::string_view name) {
  return !name.empty() && name.size() <= kMaxNameBytes && std::all_of(name.begin(), name.end(), [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '-' || c == '_' ||
           c == '.' || c == '@';
  });
}

std::vector<std::string_view> words_of(std::string_view line) {
  std::vector<std::string_view> words;
  for (line = trimmed(line); !line.empty(); line = trimmed(line.substr(words.back().size())))
    words.push_back(line.substr(0, line.find_first_of(" \t\r")));
  return words;
}

Result<void> take_right(std::string_view word, Rights& rights) {
  if (word == "admin") {
    rights.admin = true;
    return {};
  }
  const std::size_t equals = word.find('=');
  const std::string_view right = word.substr(0, equals);
  if (equals == word.npos || (right != "pub" && right != "sub" && right != "speak" && right != "rewind")) {
    return fail(ErrorCode::kInvalidArgument, "'" + std::string(word.substr(0, 64)) +
                                                 "' is none of: pub=PATTERNS, sub=PATTERNS, speak=PATTERNS, "
                                                 "rewind=PATTERNS, admin");
  }
  const auto parts = split(word.substr(equals + 1), ',');
  auto patterns = StreamPatterns::from(std::vector<std::string>(parts.begin(), parts.end()));
  if (!patterns) return patterns.error();
  (right == "pub"     ? rights.publish
   : right == "sub"   ? rights.subscribe
   : right == "speak" ? rights.speak
                      : rights.rewind) = std::move(*patterns);
  return {};
}

struct Line {
  Sha256 hash;
  StaticToken token;
};

Result<Line> line_from(std::string_view text) {
  const auto words = words_of(text);
  if (words.size() < 2 || !is_name(words[0])) {
    return fail(ErrorCode::kInvalidArgument,
                "a line is: NAME sha256:HASH [pub=PATTERNS] [sub=PATTERNS] [speak=PATTERNS] [rewind=PATTERNS] [admin]");
  }
  const auto hash = words[1].starts_with(kHash) ? Sha256::from_hex(words[1].substr(kHash.size())) : std::nullopt;
  if (!hash) {
    return fail(ErrorCode::kInvalidArgument,
                "after the name comes sha256: and 64 hexadecimal digits, the hash of the token; make one with "
                "eigencast-broker token create --static");
  }
  Line line{*hash, {std::string(words[0]), {}}};
  for (std::size_t i = 2; i < words.size(); ++i) {
    if (auto good = take_right(words[i], line.token.rights); !good) return good.error();
  }
  return line;
}

std::string joined(const std::vector<std::string>& items) {
  std::string out;
  for (const std::string& item : items) out += (out.empty() ? "" : ",") + item;
  return out;
}

}  // namespace

Result<TokenFile> TokenFile::from_text(std::string_view text, const std::string& name) {
  TokenFile file;
  std::set<std::string> names;
  std::size_t number = 0;
  for (const std::string_view line : split(text, '\n')) {
    ++number;
    const auto words = words_of(line);
    if (words.empty() || words[0].starts_with('#')) continue;
    const std::string where = name + ":" + std::to_string(number);
    auto parsed = line_from(line);
    if (!parsed) return in_context(where, parsed.error());
    if (file.tokens_.size() == kMaxTokens) {
      return in_context(where, fail(ErrorCode::kInvalidArgument, "more than 10000 tokens: use signed ones"));
    }
    const std::string token_name = parsed->token.name;
    if (!names.insert(token_name).second || !file.tokens_.emplace(parsed->hash, std::move(parsed->token)).second) {
      return in_context(
          where, fail(ErrorCode::kInvalidArgument, "'" + token_name + "' has the name or the hash of an earlier line"));
    }
  }
  return file;
}

Result<TokenFile> TokenFile::from_file(const std::string& path) {
  const auto text = read_file(path, kMaxFileBytes);
  if (!text) return text.error();
  return from_text(*text, path);
}

const StaticToken* TokenFile::find(std::string_view token) const {
  const auto found = tokens_.find(sha256(token));
  return found == tokens_.end() ? nullptr : &found->second;
}

bool TokenFile::has(const Sha256& hash, const Rights& rights) const {
  const auto found = tokens_.find(hash);
  return found != tokens_.end() && found->second.rights == rights;
}

Result<Sha256> random_bits() {
  Sha256 bits;
  if (RAND_bytes(bits.digest.data(), static_cast<int>(bits.digest.size())) != 1) {
    return fail(ErrorCode::kInternal, "the system gives no random numbers");
  }
  return bits;
}

Result<NewStaticToken> create_static_token(const std::string& name, const std::vector<std::string>& publish,
                                           const std::vector<std::string>& subscribe, bool admin,
                                           const std::vector<std::string>& speak,
                                           const std::vector<std::string>& rewind) {
  if (!is_name(name)) {
    return fail(ErrorCode::kInvalidArgument,
                "'" + name.substr(0, kMaxNameBytes) +
                    "' is not a name for a token: 1 to 64 letters, digits and any of - _ . @");
  }
  for (const auto* patterns : {&publish, &subscribe, &speak, &rewind}) {
    if (auto good = StreamPatterns::from(*patterns); !good) return good.error();
  }
  const auto random = random_bits();
  if (!random) return random.error();
  NewStaticToken made;
  made.token = std::string(kMark) + random->hex();
  made.line = name + " " + std::string(kHash) + sha256(made.token).hex();
  if (!publish.empty()) made.line += " pub=" + joined(publish);
  if (!subscribe.empty()) made.line += " sub=" + joined(subscribe);
  if (!speak.empty()) made.line += " speak=" + joined(speak);
  if (!rewind.empty()) made.line += " rewind=" + joined(rewind);
  if (admin) made.line += " admin";
  return made;
}

}  // namespace eigencast::broker
