// SPDX-License-Identifier: MIT
#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <utility>

#include "client/clip_source.h"
#include "client/open_source.h"
#include "client/raw_options.h"
#include "common/surface/formats/read.h"
#include "sdk/recorded_clip.h"

namespace eigencast {
namespace {

std::string origin_of(const std::string& url) {
  const auto parsed = parse_broker_url(url);
  return parsed ? parsed->origin() : std::string();
}

/// Resolves names and contexts to a URL with credentials. home: the broker that gets token and certificate of the
/// command line; empty: this stream's, which it is set to. Other brokers get what the contexts hold for them.
Result<Target> resolve(const std::string& stream, const RawOptions& raw, std::string& home) {
  const auto contexts = Contexts::load(Contexts::default_path());
  if (!contexts) return contexts.error();
  const bool nothing = stream.empty() && contexts->find(raw.context) == nullptr && raw.context.empty();
  const std::string to = nothing ? kLocalBroker : stream;
  const auto meant = resolve_target(to, {}, raw.context, *contexts);
  if (!meant && to.find('/') == std::string::npos && check_input(to))
    return fail(ErrorCode::kInvalidArgument,
                meant.error().message + "; the built-in shape: eigencast-client view " + to);
  if (!meant) return meant.error();
  const std::string broker = origin_of(meant->url);
  if (home.empty()) home = raw.context.empty() ? broker : origin_of(contexts->find(raw.context)->url);
  Credentials given = raw.credentials;
  if (broker != home) given = {"", raw.credentials.ca_file};
  auto target = resolve_target(to, given, raw.context, *contexts);
  if (!target) return target.error();
  const auto url = parse_broker_url(target->url);
  if (!url || url->credentials.token.empty()) return target;
  // Reports and titles show the URL: the token goes out of it.
  if (target->credentials.token.empty()) target->credentials.token = url->credentials.token;
  target->url = url->origin() + (url->prefix.empty() ? "" : url->prefix + "/v1/subscribe") + "/" + url->stream +
                (url->query.empty() ? "" : "?" + url->query);
  return target;
}

/// A word that can only be a path, by its beginning or its ending, must be there.
Result<void> check_stream_word(const std::string& word) {
  if (word.find("://") != std::string::npos) return {};
  if (word.starts_with('/') || word.starts_with('.') || word.starts_with('~'))
    return fail(ErrorCode::kNotFound, word + ": no such file or folder");
  if (!kind_of_file(word) && !is_recording(word)) return {};
  return fail(ErrorCode::kNotFound,
              word + ": no such file (a stream that ends so is given by its URL, http://HOST:7490/NAME)");
}

/// URLs of files of other machines, and of streams after "view".
Result<void> check_scheme(const std::string& word, bool files_only) {
  const auto file = clip_in(word);
  if (file && file->starts_with("//"))
    return fail(ErrorCode::kInvalidArgument, word + ": names another machine; a file of this one is file:///PATH");
  if (files_only && !file && word.find("://") != std::string::npos)
    return fail(ErrorCode::kInvalidArgument, word + ": view is for files; a stream is given without that word");
  return {};
}

/// Words that are paths become clips, or the scene that one of them holds.
Result<void> read_words(SceneDescription& scene) {
  std::vector<std::string>& words = scene.streams;
  const bool files_only = !words.empty() && words.front() == "view";
  if (files_only) words.erase(words.begin());
  if (files_only && words.empty())
    return fail(ErrorCode::kInvalidArgument, "view: name a file, a folder, a glob or a built-in shape, such as heart");
  for (std::string& word : words) {
    if (const auto good = check_scheme(word, files_only); !good) return good;
    const Wanted wanted = files_only ? Wanted{Wanted::Kind::kClip, "file:" + word} : wanted_from_word(word);
    if (wanted.kind == Wanted::Kind::kScene && words.size() > 1)
      return fail(ErrorCode::kInvalidArgument, word + ": a scene file names all streams; give it alone");
    if (wanted.kind == Wanted::Kind::kScene) return store(scene, read_scene_file(wanted.what));
    if (wanted.kind == Wanted::Kind::kClip) word = wanted.what;
    const auto file = wanted.kind == Wanted::Kind::kClip ? clip_in(word) : std::nullopt;
    if (const auto there = file ? check_input(*file) : Result<void>(); !there) return there;
    if (wanted.kind != Wanted::Kind::kStream) continue;
    if (const auto good = check_stream_word(word); !good) return good;
  }
  return {};
}

/// "list", and a broker: by its URL, or that of the context, or this machine's.
Result<void> find_listed(const RawOptions& raw, ClientOptions& options) {
  const std::vector<std::string> words = std::exchange(options.scene.streams, {});
  if (words.size() > 2) return fail(ErrorCode::kInvalidArgument, "list: name one broker, such as http://host:7490");
  options.list = true;
  std::string home, url;
  const char* const usual = std::getenv("EIGENCAST_URL");  // which says streams where none are named
  const std::string named = words.size() == 2 ? words[1] : usual != nullptr && raw.context.empty() ? usual : "";
  std::error_code ignored;
  if (words.size() == 2 &&
      (kind_of_file(named) || is_recording(named) || std::filesystem::is_regular_file(named, ignored)))
    return fail(ErrorCode::kInvalidArgument, "list: " + named + " is a file; name a broker, such as http://host:7490");
  if (!named.empty()) {
    const auto broker = parse_broker_url(named);
    if (!broker) return broker.error();
    if (words.size() == 2 && !broker->stream.empty())
      return fail(ErrorCode::kInvalidArgument, "list: " + named + " is a stream's URL; name the broker alone: " +
                                                   named.substr(0, named.rfind("/" + broker->stream)));
    url = named.find("://") != std::string::npos ? named : broker->origin() + "/" + broker->stream;
  }
  return store(options.home, resolve(url, raw, home));
}

}  // namespace

Result<std::optional<Profile>> profile_from(const CommandLine& line, const std::string& url, const RawOptions& raw) {
  const Result<BrokerUrl> parsed = parse_broker_url(url);
  if (!parsed) return parsed.error();
  const Result<Profile> asked = profile_from_query(parsed->query);
  if (!asked) return asked.error();
  const bool makes = line.has("--k") || line.has("--scheme");
  if (!makes && !line.has("--rate") && !line.has("--bands")) return std::optional<Profile>();
  Profile profile = *asked;
  if (line.has("--k")) profile.k = static_cast<std::uint8_t>(raw.k);
  if (line.has("--bands")) profile.bands = static_cast<std::uint8_t>(raw.bands);
  if (line.has("--rate")) {
    const Profile::Rate rate = kRateNames.find(raw.rate).value_or(Profile::Rate::kInterpolated);
    if (rate != profile.rate) profile.scheme = default_scheme(rate);
    profile.rate = rate;
  }
  if (line.has("--scheme")) profile.scheme = *kSchemeNames.find(raw.scheme);
  if (profile.rate == Profile::Rate::kRaw && makes) {
    return fail(ErrorCode::kInvalidArgument,
                "--k and --scheme say how the broker makes poses, but rate raw asks for the keys alone; leave them "
                "out, or ask for --rate interpolated or estimated");
  }
  if (const auto checked = check_profile(profile); !checked) return checked.error();
  return std::optional<Profile>(profile);
}

Result<void> find_streams(const RawOptions& raw, ClientOptions& options) {
  SceneDescription& scene = options.scene;
  if (!scene.streams.empty() && scene.streams.front() == "list") return find_listed(raw, options);
  if (!raw.scene.empty()) {
    if (!scene.streams.empty())
      return fail(ErrorCode::kInvalidArgument, "--scene names the streams; leave those of the command line out");
    if (const auto read = store(scene, read_scene_file(raw.scene)); !read) return read;
  } else if (const auto read = read_words(scene); !read) {
    return read;
  }
  std::string home, broker;
  if (!options.compare.empty()) {
    SceneDescription other;
    other.streams = {options.compare};
    if (const auto read = read_words(other); !read) return read;
    if (other.streams.size() != 1 || scene.streams.size() != 1)
      return fail(ErrorCode::kInvalidArgument, "--compare A B: two streams, recordings or files of one surface");
    options.compare = other.streams.front();
  }
  if (scene.streams.size() == 1 && scene.streams.front().find("://") != std::string::npos) {
    // A broker without a stream.
    const auto url = parse_broker_url(scene.streams.front());
    if (!clip_in(scene.streams.front()) && url && url->stream.empty()) broker = scene.streams.front();
    if (!broker.empty()) scene.streams.clear();
  }
  if (scene.streams.empty()) {
    if (const auto found = store(options.home, resolve(broker, raw, home)); !found) return found;
    const auto url = parse_broker_url(options.home.url);
    if (!url || url->stream.empty()) return {};
    scene.streams = {options.home.url};
    options.credentials = {options.home.credentials};
    return {};
  }
  for (std::string& stream : scene.streams) {
    Target target{stream, {}};
    if (!clip_in(stream)) {
      if (const auto resolved = store(target, resolve(stream, raw, home)); !resolved) return resolved;
    }
    stream = target.url;
    options.credentials.push_back(target.credentials);
  }
  if (options.compare.empty() || clip_in(options.compare)) return {};
  const auto other = resolve(options.compare, raw, home);
  if (!other) return other.error();
  options.compare = other->url;
  options.compare_credentials = other->credentials;
  return {};
}

std::size_t files_in(const std::vector<std::string>& streams) {
  const auto is_file = [](const std::string& stream) { return clip_in(stream).has_value(); };
  return static_cast<std::size_t>(std::count_if(streams.begin(), streams.end(), is_file));
}

}  // namespace eigencast
