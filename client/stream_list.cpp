// SPDX-License-Identifier: MIT
#include "client/stream_list.h"

#include <algorithm>
#include <cstdio>
#include <nlohmann/json.hpp>

#include "client/apps.h"
#include "common/core/files.h"
#include "common/core/text.h"
#include "common/net/http.h"
#include "common/wire/control.h"

namespace eigencast {
namespace {

using nlohmann::json;

constexpr std::chrono::seconds kSilence{2};
constexpr std::uint64_t kMaxPageBytes = 1 << 20;  ///< Of 1,000 streams.
constexpr int kMaxPages = 10;

Result<BrokerUrl> url_of(const Target& broker) {
  auto url = parse_broker_url(broker.url);
  if (!url) return url;
  const auto good = complete_credentials(*url, broker.credentials);
  return good ? std::move(url) : good.error();
}

Result<StreamPage> page_of(HttpConnection& http, const BrokerUrl& url, const std::string& after) {
  const auto answer = http.get("/v1/streams" + (after.empty() ? "" : "?after=" + after), kMaxPageBytes);
  if (!answer) return answer.error();
  const std::string_view text(reinterpret_cast<const char*>(answer->body.data()), answer->body.size());
  if (answer->status == 200) return page_from_json(text);
  const bool refused = answer->status == 401 || answer->status == 403;
  const char* const advice =
      url.credentials.token.empty() ? " (give a token with --token)" : " (the token that was given does not do)";
  return fail(refused ? ErrorCode::kRefused : ErrorCode::kUnreachable,
              url.origin() + " answered " + std::to_string(answer->status) + " to the question for its streams" +
                  (refused ? advice : ""));
}

std::string url_of_stream(const Target& broker, const std::string& stream) {
  const auto url = parse_broker_url(broker.url);
  return url->origin() + (url->prefix.empty() ? "" : url->prefix + "/v1/subscribe") + "/" + stream;
}

bool is_live(const ListedStream& stream) {
  return stream.state == "live";
}

}  // namespace

Result<StreamPage> page_from_json(std::string_view text) {
  const json document = json::parse(text, nullptr, false);
  const auto bad = [] { return fail(ErrorCode::kCorrupt, "the list of streams is not what a broker sends"); };
  if (!document.is_object() || !document.contains("streams") || !document["streams"].is_array()) return bad();
  StreamPage page;
  for (const json& each : document["streams"]) {
    if (!each.is_object()) return bad();
    const auto text_in = [&](const char* name) { return each.contains(name) && each[name].is_string(); };
    const auto number_in = [&](const char* name) { return each.contains(name) && each[name].is_number(); };
    if (!text_in("stream") || !text_in("state") || !check_stream_name(each["stream"].get<std::string>())) return bad();
    ListedStream& stream = page.streams.emplace_back();
    stream.name = each["stream"];
    stream.state = escaped(each["state"].get<std::string>());
    if (number_in("key_rate_hz")) stream.key_rate_hz = each["key_rate_hz"].get<double>();
    if (each.contains("subscribers") && each["subscribers"].is_number_unsigned())
      stream.subscribers = each["subscribers"].get<std::uint64_t>();
  }
  if (document.contains("next") && document["next"].is_string()) page.next = document["next"];
  if (!page.next.empty() && (page.streams.empty() || page.next != page.streams.back().name)) return bad();
  return page;
}

Result<std::vector<ListedStream>> streams_of(const Target& broker) {
  const auto url = url_of(broker);
  if (!url) return url.error();
  HttpConnection http(*url, kSilence);
  std::vector<ListedStream> all;
  std::string after;
  for (int pages = 0; pages < kMaxPages; ++pages) {
    auto page = page_of(http, *url, after);
    if (!page) return page.error();
    std::move(page->streams.begin(), page->streams.end(), std::back_inserter(all));
    if (page->next <= after) break;
    after = std::move(page->next);
  }
  return all;
}

int run_list(const ClientOptions& options, const LogSink& log_sink) {
  const auto streams = streams_of(options.home);
  if (!streams) {
    log(log_sink, LogLevel::kError, streams.error().message);
    return kExitNoStream;
  }
  json list = json::array();
  std::string text;
  for (const ListedStream& each : *streams) {
    const std::string url = url_of_stream(options.home, each.name);
    list.push_back({{"stream", each.name},
                    {"url", url},
                    {"state", each.state},
                    {"key_rate_hz", each.key_rate_hz},
                    {"subscribers", each.subscribers}});
    const std::string rate = is_live(each) ? formatted("%6.4g keys/s", each.key_rate_hz) : "     - keys/s";
    text += formatted("%-8s ", each.state.c_str()) + rate +
            formatted(" %6llu viewers  ", static_cast<unsigned long long>(each.subscribers)) + url + "\n";
  }
  if (streams->empty()) log(log_sink, LogLevel::kInfo, "no streams at " + parse_broker_url(options.home.url)->origin());
  if (!options.json.empty()) text = list.dump(2) + "\n";
  if (options.json.empty() || options.json == "-")
    return std::fputs(text.c_str(), stdout) < 0 ? kExitFailed : kExitGood;
  const auto written = write_file_atomically(options.json, text);
  return written ? kExitGood : failed(written.error(), log_sink);
}

Result<void> choose_live_stream(ClientOptions& options) {
  const auto streams = streams_of(options.home);
  if (!streams) return streams.error();
  const std::string where = parse_broker_url(options.home.url)->origin();
  const auto live = static_cast<std::size_t>(std::count_if(streams->begin(), streams->end(), is_live));
  if (live == 0) return fail(ErrorCode::kNotFound, "no stream is live at " + where + "; is a sender running?");
  if (live > 1) {
    constexpr std::size_t kMaxNamed = 8;
    std::string names;
    for (std::size_t i = 0, named = 0; i < streams->size() && named < kMaxNamed; ++i) {
      if (is_live((*streams)[i])) names += (named++ == 0 ? "" : ", ") + (*streams)[i].name;
    }
    return fail(ErrorCode::kNotFound, std::to_string(live) + " streams are live at " + where + ": " + names +
                                          (live > kMaxNamed ? ", ..." : "") + "; name one, such as " +
                                          url_of_stream(options.home, names.substr(0, names.find(','))));
  }
  const auto only = std::find_if(streams->begin(), streams->end(), is_live);
  options.scene.streams = {url_of_stream(options.home, only->name)};
  options.credentials = {options.home.credentials};
  return {};
}

}  // namespace eigencast
