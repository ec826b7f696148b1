// SPDX-License-Identifier: MIT
#include <cstdio>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "sdk/contexts.h"
#include "sender/commands.h"

namespace eigencast {
namespace {

void print(const Contexts& contexts, bool as_json) {
  nlohmann::json list = nlohmann::json::array();
  for (const Context& context : contexts.all()) {
    const bool current = context.name == contexts.current();
    // Tokens are secrets: whether there is one is all that is shown.
    const auto known = parse_broker_url(context.url);
    const bool in_url = known && !known->credentials.token.empty();
    const bool token = in_url || !context.credentials.token.empty();
    const std::string url = in_url ? known->shown() : context.url;
    list.push_back({{"name", context.name}, {"url", url}, {"token", token}, {"current", current}});
    if (as_json) continue;
    std::printf("%s %-16s %s%s\n", current ? "*" : " ", context.name.c_str(), url.c_str(),
                token ? "  (with a token)" : "");
  }
  if (as_json) std::printf("%s\n", list.dump(2).c_str());
  if (!as_json && list.empty()) std::puts("no contexts; add one: eigencast-sender context add NAME http://host");
}

/// Returns it as it is kept: files are named from the root, since it will be used from other folders, and
/// exist.
Result<Context> context_of(const ContextCommand& command) {
  Context context{command.name, command.url, command.credentials};
  Credentials& own = context.credentials;
  for (std::string* file : {&own.ca_file, &own.certificate_file, &own.key_file})
    if (!file->empty()) *file = std::filesystem::absolute(*file).lexically_normal().string();
  if (own.token.starts_with('@'))
    own.token = "@" + std::filesystem::absolute(own.token.substr(1)).lexically_normal().string();
  auto url = parse_broker_url(context.url);
  if (!url) return url.error();
  if (const auto usable = complete_credentials(*url, own); !usable) return usable.error();
  return context;
}

Result<void> change(Contexts& contexts, const ContextCommand& command) {
  if (command.action == "use") return contexts.use(command.name);
  if (command.action == "remove") return contexts.remove(command.name);
  auto context = context_of(command);
  return context ? contexts.add(std::move(*context)) : context.error();
}

}  // namespace

int run(const ContextCommand& command, const Console&, Interrupt&) {
  const std::string path = Contexts::default_path();
  auto contexts = Contexts::load(path);
  if (!contexts) return report_failure(contexts.error());
  if (command.action == "list") {
    print(*contexts, command.json);
    return kExitOk;
  }
  const auto changed = change(*contexts, command);
  if (!changed) return report_failure(changed.error());
  const auto saved = contexts->save(path);
  return saved ? kExitOk : report_failure(saved.error());
}

}  // namespace eigencast
