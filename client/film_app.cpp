// SPDX-License-Identifier: MIT
#include <unistd.h>

#include <algorithm>
#include <functional>
#include <utility>

#include "client/apps.h"
#include "client/clip_source.h"
#include "client/film_writer.h"
#include "client/hud_text.h"
#include "client/offscreen_viewer.h"
#include "client/patience.h"
#include "client/scene_file.h"
#include "client/stream_capture.h"
#include "common/command_line/progress.h"
#include "common/core/clock.h"
#include "common/core/files.h"
#include "common/core/text.h"

namespace eigencast {
namespace {

constexpr TimeUs kLatestPoseUs = 1'000'000;  // after the film's time the last pose is no longer on its way
constexpr TimeUs kPastUs = 10'000'000;       // in which a broker answers
constexpr double kFullTurn = 6.283185307179586;

/// All clips are opened and all streams kept before the first picture, so that drawing may take as long as it takes.
class Film {
 public:
  Film(const ClientOptions& options, const std::atomic<bool>& stop, const LogSink& log)
      : options_(options), stop_(stop), log_(log), clips_(options.scene.streams.size()) {}

  Result<int> run() {
    const FilmOptions& film = *options_.film;
    auto good = store(path_, CameraPath::read(options_.camera_path));
    if (good) good = store(writer_, FilmWriter::create(film.target, options_.width, options_.height, film.fps));
    if (good) good = open_clips();
    if (good && !captured_.empty()) good = capture();
    if (!good && good.error().code == ErrorCode::kCancelled) return kExitStopped;
    if (!good && good.error().code == ErrorCode::kTimeout)
      return log(log_, LogLevel::kError, good.error().message), kExitNoStream;
    if (good) good = begin();
    if (good) good = draw_all();
    if (good) good = writer_->finish();
    if (good && !options_.json.empty()) good = write_file_atomically(options_.json, viewer_->report());
    if (!good) return good.error();
    log(log_, LogLevel::kInfo,
        film.target.path +
            formatted(": %llu pictures, %.6g a second", static_cast<unsigned long long>(drawn_), film.fps));
    if (drawn_ < clock_->pictures()) return kExitStopped;
    return lost_ ? kExitFailed : kExitGood;
  }

 private:
  bool stopped() const { return stop_.load(); }
  ProgressLine progress() const {
    return {::isatty(STDERR_FILENO) == 1, [this] { return stopped(); }};
  }
  Error cancelled() const { return fail(ErrorCode::kCancelled, "stopped before the first picture"); }

  Result<void> open_clips() {
    const auto& streams = options_.scene.streams;
    opened_.resize(streams.size());
    ProgressLine line = progress();
    for (std::size_t i = 0; i < streams.size(); ++i) {
      if (const auto input = clip_in(streams[i])) {
        const auto clip = BakedClip::open(*input, options_.cache_dir, std::ref(line), log_);
        if (!clip) return clip.error();
        play(i, *clip, true);
      } else {
        if (const auto good =
                store(opened_[i], open_source(streams[i], &options_.credentials[i], options_, false, stop_, log_));
            !good)
          return good;
        captured_.push_back(i);
      }
    }
    return {};
  }

  void play(std::size_t stream, std::shared_ptr<const BakedClip> clip, bool loops) {
    if (loops && clip->frames.size() > 1) longest_us_ = std::max(longest_us_, clip->period_us);
    clips_[stream] = {std::move(clip), loops};
  }

  /// That show the clips from the film's beginning on.
  void open_sources() {
    film_us_ = 0;
    sources_.clear();
    for (std::size_t i = 0; i < clips_.size(); ++i) {
      opened_[i] = std::make_unique<ClipSource>(clips_[i].clip, 0, [this] { return film_us_; });
      sources_.push_back(opened_[i].get());
      Timeline* timeline = opened_[i]->timeline();
      if (timeline == nullptr) continue;
      timeline->set_interpolates(true);
      timeline->set_looping(clips_[i].loops, 0);
    }
  }

  double wanted_seconds() const {
    if (options_.film->seconds > 0) return options_.film->seconds;
    if (path_) return path_->seconds();
    return options_.turntable_s > 0 ? options_.turntable_s : static_cast<double>(longest_us_) / 1e6;
  }

  /// Keeps what the streams show from when all surfaces are there. A sender that goes makes the film shorter.
  Result<void> capture() {
    std::vector<StreamCapture> captures;
    std::vector<PoseSource*> sources;
    for (const std::size_t stream : captured_) {
      captures.emplace_back(*opened_[stream]);
      sources.push_back(opened_[stream].get());
    }
    const auto all = [&](const auto& condition) { return std::all_of(captures.begin(), captures.end(), condition); };
    const auto take = [&]() -> Result<void> {
      for (StreamCapture& each : captures) {
        if (const auto taken = each.take(std::chrono::milliseconds(5)); !taken) return taken;
      }
      return stopped() ? Result<void>(cancelled()) : Result<void>();
    };
    Patience patience(options_, captured_);
    const auto has_begun = [](const StreamCapture& each) { return each.has_surface() && !each.is_empty(); };
    while (!all(has_begun)) {
      if (const auto taken = take(); !taken) return taken;
      if (!patience.is_over(sources, false, steady_now_us())) continue;
      return fail(ErrorCode::kTimeout, patience.reason(sources));
    }
    if (options_.ago_s > 0) {
      if (const auto gone = go_back(sources, take); !gone) return gone;
      while (!all([](const StreamCapture& each) { return !each.is_empty(); })) {
        if (const auto taken = take(); !taken) return taken;
      }
    }
    for (StreamCapture& each : captures) each.begin();
    const auto wanted_us = static_cast<TimeUs>(1e6 * wanted_seconds());
    const TimeUs start = steady_now_us();
    ProgressLine line = progress();
    TimeUs length_us = 0;
    while (length_us < wanted_us && steady_now_us() - start < wanted_us + kLatestPoseUs && !lost_) {
      if (const auto taken = take(); !taken) return taken;
      lost_ = !all([](const StreamCapture& each) { return !each.is_lost(); });
      const auto shorter = [](const StreamCapture& a, const StreamCapture& b) { return a.length_us() < b.length_us(); };
      length_us = std::min_element(captures.begin(), captures.end(), shorter)->length_us();
      line(static_cast<double>(length_us) / static_cast<double>(wanted_us), "keeping the stream");
    }
    if (lost_) {
      captured_us_ = std::max<TimeUs>(length_us, 1);
      log(log_, LogLevel::kError,
          formatted("a sender or broker went, or what is kept ended, after %.1f of %.1f s: the film ends there",
                    static_cast<double>(length_us) / 1e6, wanted_seconds()));
    }
    for (std::size_t i = 0; i < captures.size(); ++i) play(captured_[i], captures[i].clip(), false);
    return {};
  }

  /// To what the brokers keep of all streams, --ago seconds ago; until that comes.
  Result<void> go_back(std::span<PoseSource* const> sources, const std::function<Result<void>()>& take) {
    const auto is_there = [](const PoseSource* source) {
      return source->info() && source->info()->rewind && source->info()->epoch == source->epoch();
    };
    const auto has_past = [](PoseSource* source) {
      const auto kept = source->rewind() != nullptr ? source->rewind()->kept() : std::nullopt;
      return kept && !kept->spans.empty();
    };
    for (PoseSource* source : sources) {
      if (source->rewind() != nullptr) source->rewind()->ask_kept();
    }
    const TimeUs start_us = steady_now_us();
    for (bool sought = false; !std::all_of(sources.begin(), sources.end(), is_there);) {
      if (const auto taken = take(); !taken) return taken;
      for (PoseSource* source : sources) {
        const auto kept = source->rewind() != nullptr ? source->rewind()->kept() : std::nullopt;
        if (kept && !kept->trouble.empty()) return fail(ErrorCode::kNotFound, "--ago: " + kept->trouble);
      }
      if (steady_now_us() - start_us > kPastUs)
        return fail(ErrorCode::kTimeout, "--ago: a broker keeps nothing of its stream, or does not show it again");
      if (sought || !std::all_of(sources.begin(), sources.end(), has_past)) continue;
      sought = true;
      const Rewind::Kept kept = *sources.front()->rewind()->kept();
      const TimeUs now_us = kept.now_at(steady_now_us());
      if (const std::string notice = text_from_short_past(kept, now_us, options_.ago_s); !notice.empty())
        log(log_, LogLevel::kWarning, notice);
      const auto at_us = now_us - static_cast<TimeUs>(1e6 * options_.ago_s);
      for (PoseSource* source : sources) source->rewind()->seek(std::max<TimeUs>(0, at_us), options_.speed);
    }
    return {};
  }

  Result<void> begin() {
    double seconds = wanted_seconds();
    if (lost_) seconds = std::min(seconds, static_cast<double>(captured_us_) / 1e6);
    if (seconds == 0)
      return fail(ErrorCode::kInvalidArgument, "nothing moves in " + clip_in(options_.scene.streams.front()).value() +
                                                   ": say --seconds, --turntable or --camera-path");
    const auto clock = FilmClock::create(seconds, options_.film->fps);
    if (!clock) return clock.error();
    clock_ = *clock;
    open_sources();
    if (const auto found = find_range(); !found) return found;
    // "auto" measures, and two films would not be the same to the bit.
    const bool on_gpu = options_.reconstruct == RebuildOn::kGpu;
    return store(viewer_, OffscreenViewer::open(options_, on_gpu ? RebuildOn::kGpu : RebuildOn::kCpu, sources_, log_));
  }

  /// Of the numbers that colours show in all pictures, so that a colour means the same in each.
  Result<void> find_range() {
    if (options_.style.colour_range || !shows_numbers(options_.style.colour)) return {};
    const auto session = Session::create(options_, sources_, {});
    if (!session) return session.error();
    ProgressLine line = progress();
    Camera camera;
    const auto total = static_cast<double>(clock_->pictures());
    for (std::uint64_t i = 0; i < clock_->pictures(); ++i) {
      if (!line(static_cast<double>(i) / total, "finding the colours' range")) return cancelled();
      film_us_ = clock_->time_us(i);
      (*session)->update({}, camera, film_us_);
      (*session)->take_colours(options_.style);
    }
    const SceneColours& colours = (*session)->colours();
    if (colours.legend(nullptr)) options_.style.colour_range = colours.range(options_.style);
    open_sources();
    return {};
  }

  /// Ends with what is there when the program is to stop.
  Result<void> draw_all() {
    ProgressLine line = progress();
    Session& session = viewer_->session();
    Camera& camera = viewer_->camera();
    const auto total = static_cast<double>(clock_->pictures());
    for (; drawn_ < clock_->pictures() && line(static_cast<double>(drawn_) / total, "drawing"); ++drawn_) {
      film_us_ = clock_->time_us(drawn_);
      session.update({}, camera, film_us_);
      if (path_)
        path_->apply(static_cast<double>(film_us_) / 1e6, camera);
      else if (options_.turntable_s > 0 && drawn_ > 0)
        camera.turn(static_cast<float>(kFullTurn / (options_.turntable_s * clock_->fps())));
      viewer_->draw([&] {
        OverlayContent content;  // other figures are of this machine's time
        content.figures = {timecode_of(opened_.front()->utc_us(film_us_))};
        content.legend = session.overlay_content().legend;
        return content;
      });
      if (const auto written = writer_->add(viewer_->picture()); !written) return written;
      session.count_written();
    }
    if (drawn_ == 0) return cancelled();
    if (const std::string why = session.colours().why_not(); !why.empty())
      log(log_, LogLevel::kWarning, "colours are not as asked for: " + why);
    if (drawn_ < clock_->pictures()) log(log_, LogLevel::kWarning, "stopped: the film ends early");
    return {};
  }

  struct Clip {
    std::shared_ptr<const BakedClip> clip;
    bool loops = false;
  };

  ClientOptions options_;
  const std::atomic<bool>& stop_;
  const LogSink& log_;
  std::vector<Clip> clips_;  ///< One for each stream.
  std::optional<CameraPath> path_;
  std::unique_ptr<FilmWriter> writer_;
  TimeUs film_us_ = 0;                               ///< What the clips show.
  std::vector<std::unique_ptr<PoseSource>> opened_;  ///< One for each stream.
  std::vector<std::size_t> captured_;                ///< Streams of brokers.
  TimeUs longest_us_ = 0;                            ///< Period of a clip.
  TimeUs captured_us_ = 0;                           ///< Of the streams.
  bool lost_ = false;
  std::optional<FilmClock> clock_;
  std::vector<PoseSource*> sources_;
  std::unique_ptr<OffscreenViewer> viewer_;
  std::uint64_t drawn_ = 0;
};

}  // namespace

int run_film(const ClientOptions& options, const std::atomic<bool>& stop, const LogSink& log_sink) {
  Film film(options, stop, log_sink);
  const Result<int> code = film.run();
  return code ? *code : failed(code.error(), log_sink);
}

}  // namespace eigencast
