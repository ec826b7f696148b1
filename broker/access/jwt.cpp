// SPDX-License-Identifier: MIT
#include "broker/access/jwt.h"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <set>

#include "common/core/text.h"

namespace eigencast::broker {
namespace {

using nlohmann::json;

constexpr int kMaxDepth = 6;
constexpr std::size_t kMaxSubjectBytes = 128;
constexpr double kLatestTime = 253'402'300'800;  // The year 10000.
constexpr auto kReplace = json::error_handler_t::replace;

Error refused(std::string why) {
  return fail(ErrorCode::kRefused, "the token " + std::move(why));
}

struct Parts {
  std::string_view header;
  std::string_view claims;
  std::string_view signature;
  std::string_view signed_text;
};

std::optional<Parts> parts_of(std::string_view token) {
  const auto parts = split(token, '.');
  if (parts.size() != 3) return std::nullopt;
  return Parts{parts[0], parts[1], parts[2], token.substr(0, token.rfind('.'))};
}

/// Parses an object without duplicate members: two parsers could disagree on which one counts.
std::optional<json> strict_object(std::string_view text) {
  std::vector<std::set<std::string>> seen;
  bool good = true;
  const auto watch = [&](int depth, json::parse_event_t event, json& parsed) {
    if (depth > kMaxDepth) good = false;
    if (event == json::parse_event_t::object_start) seen.emplace_back();
    if (seen.empty()) return good;
    if (event == json::parse_event_t::object_end) seen.pop_back();
    if (event == json::parse_event_t::key) good = seen.back().insert(parsed.get<std::string>()).second && good;
    return good;
  };
  json object = json::parse(text.begin(), text.end(), watch, false);
  if (!good || !object.is_object()) return std::nullopt;
  return object;
}

std::optional<json> object_from_part(std::string_view part) {
  const auto bytes = bytes_from_base64(part, Base64::kUrl);
  return bytes ? strict_object(std::string(bytes->begin(), bytes->end())) : std::nullopt;
}

std::string part_from_object(const json& object) {
  const std::string text = object.dump(-1, ' ', false, kReplace);
  return base64_from_bytes(Bytes(text.begin(), text.end()), Base64::kUrl);
}

/// A text member; empty if absent. Nothing: it has another type.
std::optional<std::string> optional_text(const json& object, const char* name) {
  const auto found = object.find(name);
  if (found == object.end()) return std::string();
  if (!found->is_string()) return std::nullopt;
  return found->get<std::string>();
}

/// A NumericDate without its fraction.
std::optional<std::int64_t> time_of(const json& value) {
  if (!value.is_number()) return std::nullopt;
  const double seconds = value.get<double>();
  if (!std::isfinite(seconds) || seconds < 0 || seconds > kLatestTime) return std::nullopt;
  return static_cast<std::int64_t>(std::floor(seconds));
}

Result<const TokenKey*> key_for(const json& header, const std::vector<TokenKey>& keys) {
  const auto id = optional_text(header, "kid");
  if (!id) return refused("is malformed: \"kid\" is not a text");
  if (!header.contains("kid") && keys.size() == 1) return &keys.front();
  for (const TokenKey& key : keys) {
    if (key.id() == *id) return &key;
  }
  return refused(id->empty() ? "names no key (\"kid\"), and this broker has no unnamed key"
                             : "is signed with key '" + escaped(id->substr(0, 64)) +
                                   "' (\"kid\"), which this broker does not know");
}

Result<const TokenKey*> check_signature(const Parts& parts, const json& header, const std::vector<TokenKey>& keys) {
  if (header.contains("crit")) return refused("asks for extensions (\"crit\") that this broker does not have");
  const auto key = key_for(header, keys);
  if (!key) return key;
  const auto algorithm = optional_text(header, "alg");
  const std::string_view wanted = kAlgorithms[(*key)->algorithm()];
  if (!algorithm || *algorithm != wanted) {
    return refused("has the algorithm '" + escaped(algorithm.value_or("?").substr(0, 64)) + "' (\"alg\"), but key '" +
                   (*key)->id() + "' is for " + std::string(wanted) + " only");
  }
  const auto signature = bytes_from_base64(parts.signature, Base64::kUrl);
  if (!signature || !(*key)->verifies(parts.signed_text, *signature)) {
    return refused("has a wrong signature: key '" + (*key)->id() + "' did not make it");
  }
  return key;
}

bool names_audience(const json& claims, const std::string& wanted) {
  const auto audience = claims.find("aud");
  if (audience == claims.end()) return false;
  if (!audience->is_array()) return *audience == wanted;
  return std::any_of(audience->begin(), audience->end(), [&](const json& one) { return one == wanted; });
}

Result<void> check_times(const json& object, const TokenRules& rules, std::int64_t now_s, Claims& claims) {
  const auto expires = object.contains("exp") ? time_of(object["exp"]) : std::nullopt;
  if (!expires) return refused("does not say when it expires (\"exp\", in Unix seconds)");
  claims.expires_s = *expires;
  if (now_s >= *expires + rules.leeway_s) {
    return refused("expired " + std::to_string(now_s - *expires) + " s ago (\"exp\"): get a new one");
  }
  if (!object.contains("nbf")) return {};
  claims.not_before_s = time_of(object["nbf"]);
  if (!claims.not_before_s) return refused("has a \"nbf\" that is not a time in Unix seconds");
  if (now_s + rules.leeway_s >= *claims.not_before_s) return {};
  return refused("is valid only in " + std::to_string(*claims.not_before_s - now_s) +
                 " s (\"nbf\"): are the clocks right?");
}

Result<StreamPatterns> patterns_of(const json& object, const char* name) {
  const auto found = object.find(name);
  if (found == object.end()) return StreamPatterns();
  std::vector<std::string> texts;
  if (!found->is_array() || found->size() > StreamPatterns::kMaxPatterns) {
    return refused("has an \"eigencast\"." + std::string(name) + " that is not a list of at most 256 patterns");
  }
  for (const json& item : *found) {
    if (!item.is_string()) return refused("has a stream pattern that is not a text");
    texts.push_back(item.get<std::string>());
  }
  auto patterns = StreamPatterns::from(texts);
  if (!patterns) return refused("has a bad stream pattern: " + patterns.error().message);
  return patterns;
}

/// Refuses unknown members: a later version might use one to restrict rights.
Result<Rights> rights_of(const json& object) {
  const auto found = object.find("eigencast");
  if (found == object.end() || !found->is_object()) {
    return refused("grants nothing here: it has no claim \"eigencast\": {\"pub\": [...], \"sub\": [...]}");
  }
  for (const auto& [name, value] : found->items()) {
    if (name != "pub" && name != "sub" && name != "speak" && name != "rewind" && name != "admin") {
      return refused("has an unknown member \"" + escaped(name.substr(0, 64)) + "\" in its claim \"eigencast\"");
    }
  }
  auto publish = patterns_of(*found, "pub");
  if (!publish) return publish.error();
  auto subscribe = patterns_of(*found, "sub");
  if (!subscribe) return subscribe.error();
  auto speak = patterns_of(*found, "speak");
  if (!speak) return speak.error();
  auto rewind = patterns_of(*found, "rewind");
  if (!rewind) return rewind.error();
  const auto admin = found->find("admin");
  if (admin != found->end() && !admin->is_boolean()) return refused("has an \"admin\" that is not true or false");
  return Rights{std::move(*publish), std::move(*subscribe), admin != found->end() && admin->get<bool>(),
                std::move(*speak), std::move(*rewind)};
}

Result<void> check_claims(const json& object, const TokenRules& rules, std::int64_t now_s, Claims& claims) {
  if (auto good = check_times(object, rules, now_s, claims); !good) return good;
  if (!rules.audience.empty() && !names_audience(object, rules.audience)) {
    return refused("is not for this broker: its audience (\"aud\") is not '" + rules.audience + "'");
  }
  if (!rules.issuer.empty() && optional_text(object, "iss") != rules.issuer) {
    return refused("comes from another issuer (\"iss\") than '" + rules.issuer + "'");
  }
  const auto subject = optional_text(object, "sub");
  const auto is_plain = [](char c) { return c > ' ' && c <= '~'; };
  if (!subject || subject->size() > kMaxSubjectBytes || !std::all_of(subject->begin(), subject->end(), is_plain)) {
    return refused("has a subject (\"sub\") that is not a text of at most 128 printable characters without blanks");
  }
  claims.subject = *subject;
  if (const auto good = store(claims.rights, rights_of(object)); !good) return good.error();
  return {};
}

}  // namespace

Result<Claims> verify_token(std::string_view token, const TokenRules& rules, std::int64_t now_unix_s) {
  if (token.size() > kMaxTokenBytes) return refused("is longer than 8 KiB");
  const auto parts = parts_of(token);
  if (!parts) return refused("is malformed: it is not three parts joined by dots");
  const auto header = object_from_part(parts->header);
  if (!header) return refused("is malformed: its header is not a JSON object in base64url");
  const auto key = check_signature(*parts, *header, rules.keys);
  if (!key) return key.error();
  const auto object = object_from_part(parts->claims);
  if (!object) return refused("is malformed: its claims are not a JSON object in base64url");
  Claims claims;
  claims.key_id = (*key)->id();
  if (auto good = check_claims(*object, rules, now_unix_s, claims); !good) return good.error();
  return claims;
}

std::optional<Claims> TokenCache::find(const Sha256& token, std::int64_t leeway_s, std::int64_t now_unix_s) {
  const std::lock_guard lock(mutex_);
  const auto found = claims_.find(token);
  if (found == claims_.end()) return std::nullopt;
  const Claims& claims = found->second;
  const bool over = now_unix_s >= claims.expires_s + leeway_s;
  const bool early = claims.not_before_s && now_unix_s + leeway_s < *claims.not_before_s;
  if (!over && !early) return claims;
  claims_.erase(found);
  return std::nullopt;
}

void TokenCache::keep(const Sha256& token, const Claims& claims) {
  const std::lock_guard lock(mutex_);
  if (claims_.size() >= kMaxTokens) claims_.clear();
  claims_.insert_or_assign(token, claims);
}

Result<std::string> create_token(const TokenRequest& request, const TokenKey& key) {
  for (const auto* patterns : {&request.publish, &request.subscribe, &request.speak, &request.rewind}) {
    if (auto good = StreamPatterns::from(*patterns); !good) return good.error();
  }
  json header = {{"alg", kAlgorithms[key.algorithm()]}, {"typ", "JWT"}};
  if (!key.id().empty()) header["kid"] = key.id();
  json claims = {{"iat", request.issued_s}, {"exp", request.expires_s}, {"eigencast", json::object()}};
  if (!request.subject.empty()) claims["sub"] = request.subject;
  if (!request.audience.empty()) claims["aud"] = request.audience;
  if (!request.issuer.empty()) claims["iss"] = request.issuer;
  if (!request.publish.empty()) claims["eigencast"]["pub"] = request.publish;
  if (!request.subscribe.empty()) claims["eigencast"]["sub"] = request.subscribe;
  if (!request.speak.empty()) claims["eigencast"]["speak"] = request.speak;
  if (!request.rewind.empty()) claims["eigencast"]["rewind"] = request.rewind;
  if (request.admin) claims["eigencast"]["admin"] = true;
  const std::string text = part_from_object(header) + "." + part_from_object(claims);
  const auto signature = key.sign(text);
  if (!signature) return signature.error();
  return text + "." + base64_from_bytes(*signature, Base64::kUrl);
}

Result<TokenParts> read_token(std::string_view token) {
  const auto parts = token.size() > kMaxTokenBytes ? std::nullopt : parts_of(token);
  const auto header = parts ? object_from_part(parts->header) : std::nullopt;
  const auto claims = parts ? object_from_part(parts->claims) : std::nullopt;
  if (!header || !claims) {
    return fail(ErrorCode::kCorrupt, "this is not a JSON Web Token: two JSON objects and a signature in base64url");
  }
  return TokenParts{header->dump(2, ' ', true, kReplace), claims->dump(2, ' ', true, kReplace)};
}

}  // namespace eigencast::broker
