// SPDX-License-Identifier: MIT
#include <cstdio>
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
    list.push_back({{"name", context.name},
                    {"url", context.url},
                    {"token", !context.credentials.token.empty()},
                    {"current", current}});
    if (as_json) continue;
    std::printf("%s %-16s %s%s\n", current ? "*" : " ", context.name.c_str(), context.url.c_str(),
                context.credentials.token.empty() ? "" : "  (with a token)");
  }
  if (as_json) std::printf("%s\n", list.dump(2).c_str());
  if (!as_json && list.empty()) std::puts("no contexts; add one: eigencast-sender context add NAME ws://host");
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
  const auto changed = command.action == "add"   ? contexts->add({command.name, command.url, command.credentials})
                       : command.action == "use" ? contexts->use(command.name)
                                                 : contexts->remove(command.name);
  if (!changed) return report_failure(changed.error());
  const auto saved = contexts->save(path);
  return saved ? kExitOk : report_failure(saved.error());
}

}  // namespace eigencast
