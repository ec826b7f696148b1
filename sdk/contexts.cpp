// SPDX-License-Identifier: MIT
#include "sdk/contexts.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "common/core/files.h"
#include "common/net/url.h"

namespace eigencast {
namespace {

using nlohmann::json;

constexpr std::uint64_t kMaxFileBytes = 1 << 20;

bool is_name(const std::string& name) {
  return !name.empty() && name.size() <= 64 && std::all_of(name.begin(), name.end(), [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '-' || c == '_' ||
           c == '.';
  });
}

std::string string_of(const json& object, const char* key) {
  const auto at = object.find(key);
  return at != object.end() && at->is_string() ? at->get<std::string>() : std::string();
}

Context context_from(const json& entry) {
  Context context{string_of(entry, "name"), string_of(entry, "url")};
  context.credentials = {string_of(entry, "token"), string_of(entry, "ca"), string_of(entry, "certificate"),
                         string_of(entry, "key"), entry.contains("insecure") && entry["insecure"] == true};
  return context;
}

json json_from(const Context& context) {
  json entry{{"name", context.name}, {"url", context.url}};
  const Credentials& own = context.credentials;
  const std::pair<const char*, const std::string*> texts[] = {
      {"token", &own.token}, {"ca", &own.ca_file}, {"certificate", &own.certificate_file}, {"key", &own.key_file}};
  for (const auto& [name, text] : texts) {
    if (!text->empty()) entry[name] = *text;
  }
  if (own.insecure) entry["insecure"] = true;
  return entry;
}

// Created for its owner alone: it may hold tokens.
bool write_private(const std::string& path, const std::string& text) {
  const int descriptor = ::open(path.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, S_IRUSR | S_IWUSR);
  if (descriptor < 0) return false;
  const bool written = ::write(descriptor, text.data(), text.size()) == static_cast<ssize_t>(text.size());
  return ::close(descriptor) == 0 && written;
}

bool has_scheme(const std::string& to) {
  return to.find("://") != std::string::npos;
}

const Context* context_for(const std::string& to, const std::string& name, const Contexts& contexts) {
  const Context* current = contexts.find(name);
  const auto meant = parse_broker_url(to);
  if (!name.empty() || !meant || !has_scheme(to)) return current;
  const auto is_its = [&](const Context& context) {
    const auto known = parse_broker_url(context.url);
    return known && known->origin() == meant->origin();
  };
  if (current != nullptr && is_its(*current)) return current;
  const auto at = std::find_if(contexts.all().begin(), contexts.all().end(), is_its);
  return at == contexts.all().end() ? current : &*at;
}

/// `own` wins, each part for itself.
Credentials merged(Credentials own, const Credentials& other) {
  if (own.token.empty()) own.token = other.token;
  if (own.ca_file.empty()) own.ca_file = other.ca_file;
  if (own.certificate_file.empty() && own.key_file.empty()) {
    own.certificate_file = other.certificate_file;
    own.key_file = other.key_file;
  }
  own.insecure = own.insecure || other.insecure;
  return own;
}

}  // namespace

std::string Contexts::default_path() {
  const char* config = std::getenv("XDG_CONFIG_HOME");
  if (config != nullptr && *config == '/') return std::string(config) + "/eigencast/contexts.json";
  const char* home = std::getenv("HOME");
  return home != nullptr && *home != '\0' ? std::string(home) + "/.config/eigencast/contexts.json" : std::string();
}

Result<Contexts> Contexts::load(const std::string& path) {
  Contexts contexts;
  std::error_code ignored;
  if (path.empty() || !std::filesystem::exists(path, ignored)) return contexts;
  const auto text = read_file(path, kMaxFileBytes);
  if (!text) return text.error();
  const json root = json::parse(*text, nullptr, false);
  if (!root.is_object() || !root.contains("contexts") || !root["contexts"].is_array()) {
    return fail(ErrorCode::kCorrupt, path + ": not a file of contexts; remove it, or mend it");
  }
  for (const json& entry : root["contexts"]) {
    if (!entry.is_object()) return fail(ErrorCode::kCorrupt, path + ": a context is not an object");
    if (const auto added = contexts.add(context_from(entry)); !added) return in_context(path, added.error());
  }
  const std::string current = string_of(root, "current");
  if (contexts.find(current) != nullptr) contexts.current_ = current;
  return contexts;
}

Result<void> Contexts::save(const std::string& path) const {
  if (path.empty()) return fail(ErrorCode::kIo, "no folder for contexts: neither XDG_CONFIG_HOME nor HOME is set");
  json root{{"current", current_}, {"contexts", json::array()}};
  for (const Context& context : all_) {
    root["contexts"].push_back(json_from(context));
  }
  std::error_code code;
  std::filesystem::create_directories(std::filesystem::path(path).parent_path(), code);
  const std::string part = path + ".part";
  // Left from a run that was cut off, it might be readable by others.
  std::filesystem::remove(part, code);
  const bool written = write_private(part, root.dump(2) + "\n") && std::rename(part.c_str(), path.c_str()) == 0;
  return written ? Result<void>() : fail(ErrorCode::kIo, path + ": cannot be written: " + std::strerror(errno));
}

const Context* Contexts::find(const std::string& name) const {
  const std::string& wanted = name.empty() ? current_ : name;
  const auto at = std::find_if(all_.begin(), all_.end(), [&](const Context& c) { return c.name == wanted; });
  return at == all_.end() ? nullptr : &*at;
}

Error Contexts::unknown(const std::string& name) const {
  std::string names;
  for (const Context& context : all_) names += (names.empty() ? "" : ", ") + context.name;
  return fail(ErrorCode::kNotFound, "no context \"" + name + "\"; there are: " + (names.empty() ? "none" : names));
}

Result<void> Contexts::add(Context context) {
  if (!is_name(context.name)) {
    return fail(ErrorCode::kInvalidArgument,
                "a context's name is 1 to 64 of A-Z a-z 0-9 . _ -, not \"" + context.name + "\"");
  }
  if (const auto url = parse_broker_url(context.url); !url) return url.error();
  const std::string name = context.name;
  const auto at = std::find_if(all_.begin(), all_.end(), [&](const Context& c) { return c.name == name; });
  if (at != all_.end()) {
    *at = std::move(context);
  } else {
    all_.push_back(std::move(context));
  }
  if (current_.empty()) current_ = name;
  return {};
}

Result<void> Contexts::use(const std::string& name) {
  if (name.empty() || find(name) == nullptr) return unknown(name);
  current_ = name;
  return {};
}

Result<void> Contexts::remove(const std::string& name) {
  if (name.empty() || find(name) == nullptr) return unknown(name);
  std::erase_if(all_, [&](const Context& c) { return c.name == name; });
  if (current_ == name) current_ = all_.empty() ? "" : all_.front().name;
  return {};
}

Result<Target> resolve_target(const std::string& to, const Credentials& given, const std::string& name,
                              const Contexts& contexts) {
  const Context* context = context_for(to, name, contexts);
  if (!name.empty() && context == nullptr)
    return fail(ErrorCode::kNotFound, "no context \"" + name + "\"; see: eigencast-sender context list");
  const bool is_url = has_scheme(to);
  if (context == nullptr && to.find('/') == std::string::npos) {
    const std::string what =
        to.empty() ? "no stream is named" : to + ": a stream's name without its broker, and no file";
    return fail(ErrorCode::kInvalidArgument, what + "; give http://host:7490/" + (to.empty() ? "stream" : to) +
                                                 ", or: eigencast-sender context add NAME http://host:7490");
  }
  Target target{to, given};
  if (context == nullptr) return target;
  const auto known = parse_broker_url(context->url);
  if (!known) return known.error();
  if (to.empty()) {
    target.url = context->url;
  } else if (!is_url) {
    target.url = known->origin() + (known->prefix.empty() ? "" : known->prefix + "/v1/publish") + "/" + to;
  }
  const auto meant = parse_broker_url(target.url);
  const bool same_broker = meant && meant->origin() == known->origin();
  if (same_broker) target.credentials = merged(given, context->credentials);
  return target;
}

Result<Target> resolve_beside(const Target& home, const std::string& to, const Credentials& given,
                              const std::string& context, const Contexts& contexts) {
  const auto meant = resolve_target(to, {}, context, contexts);
  if (!meant) return meant;
  const auto there = parse_broker_url(meant->url), here = parse_broker_url(home.url);
  const bool same_broker = there && here && there->origin() == here->origin();
  return resolve_target(to, same_broker ? given : Credentials{{}, given.ca_file}, context, contexts);
}

}  // namespace eigencast
