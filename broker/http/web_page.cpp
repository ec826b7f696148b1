// SPDX-License-Identifier: MIT
#include "broker/http/web_page.h"

#include <algorithm>
#include <array>
#include <ctime>
#include <filesystem>
#include <variant>

#include "broker/http/http_target.h"
#include "broker/relay/hub.h"
#include "common/core/files.h"

namespace eigencast::broker {
namespace {

constexpr std::uint64_t kMaxFileBytes = 16 << 20;
constexpr int kPageRetryAfterS = 60;
constexpr std::string_view kLetters = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789.-_";

std::string_view type_of(std::string_view name) {
  constexpr std::pair<std::string_view, std::string_view> kTypes[] = {{".html", "text/html; charset=utf-8"},
                                                                      {".js", "text/javascript; charset=utf-8"},
                                                                      {".css", "text/css; charset=utf-8"},
                                                                      {".wasm", "application/wasm"}};
  for (const auto& [end, type] : kTypes) {
    if (name.ends_with(end)) return type;
  }
  return "application/octet-stream";
}

std::string etag_of(std::string_view text) {
  return "\"" + sha256(text).hex().substr(0, 32) + "\"";
}

/// By its size and when it changed: its bytes would take long for each request. Empty: it cannot be read.
std::string etag_of_file(const std::string& path) {
  std::error_code error;
  const auto changed = std::filesystem::last_write_time(path, error).time_since_epoch().count();
  const auto bytes = error ? 0 : std::filesystem::file_size(path, error);
  return error ? std::string() : etag_of(std::to_string(bytes) + " " + std::to_string(changed));
}

/// Found in web.folder. Without text where the client has it already.
struct FolderFile {
  std::shared_ptr<const std::string> text = std::make_shared<const std::string>();
  std::string etag;
};

Result<FolderFile> file_in_folder(const std::string& path, const std::string& known_etags) {
  FolderFile file;
  file.etag = etag_of_file(path);
  if (!file.etag.empty() && etag_matches(known_etags, file.etag)) return file;
  auto text = read_file(path, kMaxFileBytes);
  if (!text) return text.error();
  file.text = std::make_shared<const std::string>(std::move(*text));
  return file;
}

void answer_missing(HttpConnection& connection, const std::string& why, HttpHeaders headers = {}) {
  headers.emplace_back("Cache-Control", "no-store");
  connection.answer_error(HttpStatus::kNotFound, fail(ErrorCode::kNotFound, why), std::move(headers));
}

/// Answers by 304 where the client has it already; else charges the client's address for what `owner` keeps.
void answer_body(HttpConnection& connection, std::string_view body, std::shared_ptr<const void> owner,
                 const std::string& etag, HttpHeaders headers) {
  headers.emplace_back("ETag", etag);
  if (etag_matches(connection.header("If-None-Match"), etag)) {
    return connection.answer(HttpStatus::kNotModified, {}, std::move(headers));
  }
  const TimeUs now_us = steady_now_us();
  const auto payer = connection.context().gate.stranger(connection.access_request({}), now_us);
  const auto taken = payer->take_download(connection.method() == "HEAD" ? 0 : body.size(), now_us);
  if (!taken) return connection.answer_limit(taken.error().message, kPageRetryAfterS);
  connection.answer_with(HttpStatus::kOk, body, std::move(owner), std::move(headers));
}

/// Calls `then` with the file, empty if the client has its `known_etags`, who keeps it, and its ETag in web.folder, or
/// what is built in; or answers why there is none.
void find_file(HttpConnection& connection, std::string_view name, const std::string& known_etags,
               std::function<void(const WebFile&, const std::shared_ptr<const void>&, const std::string& etag)> then) {
  const auto& web = connection.context().config.web;
  if (!web.enabled) return answer_missing(connection, "the page of this broker is off (web.enabled)");
  if (name.empty() || name.starts_with('.') || name.find_first_not_of(kLetters) != std::string_view::npos) {
    return answer_missing(connection, "the page has no file of that name");
  }
  if (!web.folder.empty()) {
    connection.arm(connection.context().config.timeouts.transfer_ms);
    return connection.on(
        connection.context().disk,
        [path = web.folder + "/" + std::string(name), known_etags] { return file_in_folder(path, known_etags); },
        [&connection, name = std::string(name), then = std::move(then)](const Result<FolderFile>& file) {
          if (!file) return answer_missing(connection, "web.folder has no such file");
          then({name, *file->text, {}, {}}, file->text, file->etag);
        });
  }
  const auto files = web_files();
  const auto file = std::find_if(files.begin(), files.end(), [&](const WebFile& each) { return each.name == name; });
  if (file != files.end()) return then(*file, nullptr, "\"" + std::string(web_version()) + "\"");
  answer_missing(connection, files.empty() ? "this broker was built without the page: cmake says what it takes"
                                           : "the page has no file of that name");
}

/// What of a file the client takes, with its name; nothing: neither coding nor the file as it is.
std::optional<std::pair<std::string_view, std::string_view>> chosen_coding(std::string_view accepted,
                                                                           const WebFile& file) {
  const auto given = weights_of(accepted, {"br", "gzip", "identity", "*"});
  const auto weight = [&](std::size_t at, int unnamed) {
    return given[at] >= 0 ? given[at] : given[3] >= 0 ? given[3] : unnamed;
  };
  const std::array<std::pair<int, std::pair<std::string_view, std::string_view>>, 3> all{
      {{file.brotli.empty() ? 0 : weight(0, 0), {"br", file.brotli}},
       {file.gzip.empty() ? 0 : weight(1, 0), {"gzip", file.gzip}},
       {weight(2, 1), {{}, file.plain}}}};
  const auto best = std::max_element(all.begin(), all.end(), [](auto& a, auto& b) { return a.first < b.first; });
  return best->first > 0 ? std::optional(best->second) : std::nullopt;
}

/// Whether a request for a stream's URL wants to read HTML: its first choice, or as good as JSON that it does not name.
bool wants_html(const std::string& accepted) {
  const auto given = weights_of(accepted, {"text/html", "text/*", "application/json", "application/*", "*/*"});
  const auto weight = [&](std::size_t at) {
    return given[at] >= 0 ? given[at] : given[at + 1] >= 0 ? given[at + 1] : given[4];
  };
  const int html = weight(0), json = weight(2);
  return html > json || (html == json && given[2] < 0);
}

/// From a stream's URL to the broker's root: proxies may have put a path in front.
std::string root_from(std::string_view stream) {
  std::string up;
  for (auto slashes = std::count(stream.begin(), stream.end(), '/'); slashes > 0; --slashes) up += "../";
  return up;
}

/// Sources of a content security policy are separated by blanks, its directives by ';'.
std::string content_policy(const HttpConnection& connection, const Context& context) {
  const auto fits = [](std::string_view source, const char* more) {
    return source.find_first_not_of(std::string(kLetters) + more) == std::string_view::npos;
  };
  const auto policy = context.gate.policy();
  const std::string host = policy->host_of_page(connection.access_request({}));
  std::string text =
      "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self'; img-src 'self' data: blob:; "
      "worker-src 'self'; connect-src 'self'";
  if (!host.empty() && fits(host, ":[]")) text += " ws://" + host + " wss://" + host;
  text += "; base-uri 'none'; form-action 'none'; frame-ancestors 'self'";
  for (const std::string& origin : context.config.access.origins) {
    if (fits(origin, ":[]/*")) text += " " + origin;
  }
  return text;
}

/// Lets the browser fetch the surface beside the code, where this request would be told of it without a token.
std::string preload_of(const HttpConnection& connection, Context& context, const std::string& stream) {
  const AccessRequest request = connection.access_request({});
  if (stream.empty() || !request.authorization.empty()) return {};
  const auto found = context.gate.policy()->identify(request, std::time(nullptr));
  const auto* identity = std::get_if<Identity>(&found);
  if (identity == nullptr || !identity->rights.subscribe.matches(stream)) return {};
  const Stream* const known = context.hub.find(stream);
  if (known == nullptr || known->epoch() == 0) return {};
  return "<link rel=\"preload\" href=\"" + root_from(stream) + "v1/assets/" + known->asset() +
         "\" as=\"fetch\" crossorigin>";
}

void replace_all(std::string& text, std::string_view mark, std::string_view by) {
  for (auto at = text.find(mark); at != std::string::npos; at = text.find(mark, at + by.size())) {
    text.replace(at, mark.size(), by);
  }
}

void answer_endpoints(HttpConnection& connection, const std::string& stream) {
  const std::string v1 = root_from(stream) + "v1/", name = stream.empty() ? "" : "/" + stream;
  std::string body = "{\"subscribe\":\"" + v1 + "subscribe" + name;
  if (!stream.empty()) body += "\",\"publish\":\"" + v1 + "publish" + name;
  body += "\",\"assets\":\"" + v1 + "assets/\",\"streams\":\"" + v1 + "streams\"}\n";
  connection.answer(HttpStatus::kOk, std::move(body), {kAnyOrigin, {"Vary", "Accept"}, {"Cache-Control", "no-cache"}});
}

}  // namespace

bool has_page(const Config& config) {
  return config.web.enabled && (!config.web.folder.empty() || !web_files().empty());
}

void serve_page(HttpConnection& connection, const std::string& stream) {
  if (!connection.reads()) return connection.refuse_method("a stream's page takes GET and HEAD", "GET, HEAD");
  if (connection.is_websocket_upgrade()) {
    return answer_missing(connection, "the WebSockets of a stream are /v1/subscribe/STREAM and /v1/publish/STREAM");
  }
  if (!wants_html(connection.joined_headers("Accept"))) return answer_endpoints(connection, stream);
  find_file(connection, "page.html", {},
            [&connection, stream](const WebFile& page, const auto&, const std::string& etag) {
              Context& context = connection.context();
              std::string version(context.config.web.folder.empty() ? web_version() : "");
              const std::string files = root_from(stream) + "v1/web/" + (version.empty() ? "" : version + "/");
              const std::string head_end = preload_of(connection, context, stream) + "</head>";
              const auto text = std::make_shared<std::string>(page.plain);
              replace_all(*text, "{web}", files);
              replace_all(*text, "</head>", head_end);
              answer_body(connection, *text, text, etag_of(etag + files + head_end),
                          {{"Content-Type", "text/html; charset=utf-8"},
                           {"Cache-Control", "no-cache"},
                           {"Content-Security-Policy", content_policy(connection, context)},
                           {"Referrer-Policy", "no-referrer"},
                           {"Vary", "Accept"}});
            });
}

void serve_web_file(HttpConnection& connection, std::string_view rest) {
  if (!connection.reads()) return connection.refuse_method("files of the page take GET and HEAD", "GET, HEAD");
  // Another version's URL must not be answered, and so kept for ever, with this one's bytes.
  const std::string current = std::string(web_version()) + "/";
  const bool versioned = connection.context().config.web.folder.empty() && rest.starts_with(current);
  if (versioned) rest.remove_prefix(current.size());
  const auto answer = [&connection, versioned](const WebFile& file, const auto& owner, const std::string& plain_etag) {
    const auto coding = chosen_coding(connection.joined_headers("Accept-Encoding"), file);
    HttpHeaders headers{kAnyOrigin, {"Vary", "Accept-Encoding"}};
    if (!coding) {
      const Error why = fail(ErrorCode::kUnsupported, "accept gzip, br or identity");
      return connection.answer_error(HttpStatus::kNotAcceptable, why, std::move(headers));
    }
    headers.emplace_back("Content-Type", type_of(file.name));
    headers.emplace_back("Cache-Control", versioned ? "public, max-age=31536000, immutable" : "no-cache");
    if (!coding->first.empty()) headers.emplace_back("Content-Encoding", coding->first);
    std::string etag = plain_etag;
    etag.insert(etag.size() - 1, coding->first);
    answer_body(connection, coding->second, owner, etag, std::move(headers));
  };
  find_file(connection, rest, connection.header("If-None-Match"), answer);
}

}  // namespace eigencast::broker
