// SPDX-License-Identifier: MIT
#include <unistd.h>

#include <algorithm>
#include <utility>

#include "client/apps.h"
#include "client/clip_source.h"
#include "client/film_writer.h"
#include "client/patience.h"
#include "client/scene_file.h"
#include "client/session.h"
#include "client/stream_capture.h"
#include "common/command_line/progress.h"
#include "common/core/clock.h"
#include "common/core/files.h"
#include "common/core/text.h"
#include "view/overlay.h"
#include "view/renderer.h"

namespace eigencast {
namespace {

constexpr TimeUs kLatestPoseUs = 1'000'000;  // after the film's time the last pose is no longer on its way
constexpr double kFullTurn = 6.283185307179586;

/// All clips are opened and all streams kept before the first picture, so that drawing may take as long as it takes.
class Film {
 public:
  Film(const ClientOptions& options, const std::atomic<bool>& stop, const LogSink& log)
      : options_(options), stop_(stop), log_(log) {}

  Result<int> run() {
    const FilmOptions& film = *options_.film;
    auto good = store(path_, CameraPath::read(options_.camera_path));
    if (good) good = store(writer_, FilmWriter::create(film.target, options_.width, options_.height, film.fps));
    if (good) good = open_clips();
    if (good && !captured_.empty()) good = capture();
    if (!good && good.error().code == ErrorCode::kCancelled) return kExitGood;
    if (!good && good.error().code == ErrorCode::kTimeout)
      return log(log_, LogLevel::kError, good.error().message), kExitNoStream;
    if (good) good = begin();
    if (good) good = draw_all();
    if (good) good = writer_->finish();
    if (good && !options_.json.empty())
      good = write_file_atomically(options_.json, session_->report(*renderer_, options_.width, options_.height));
    if (!good) return good.error();
    log(log_, LogLevel::kInfo,
        film.target.path +
            formatted(": %llu pictures, %.6g a second", static_cast<unsigned long long>(drawn_), film.fps));
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
        const auto clip = BakedClip::open(*input, options_.cache_dir, std::ref(line));
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
    opened_[stream] = std::make_unique<ClipSource>(std::move(clip), 0, [this] { return film_us_; });
    if (Timeline* timeline = opened_[stream]->timeline()) {
      timeline->set_interpolates(true);
      timeline->set_looping(loops, 0);
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
    Patience patience(options_);
    while (!all([](const StreamCapture& each) { return each.has_surface() && !each.is_empty(); })) {
      if (const auto taken = take(); !taken) return taken;
      if (patience.is_over(sources, false, steady_now_us()))
        return fail(ErrorCode::kTimeout,
                    patience.fate_of(options_.scene.streams[captured_.front()], sources.front()->stats().detail));
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
          formatted("a sender or broker went after %.1f of %.1f s: the film ends there",
                    static_cast<double>(length_us) / 1e6, wanted_seconds()));
    }
    for (std::size_t i = 0; i < captures.size(); ++i) play(captured_[i], captures[i].clip(), false);
    return {};
  }

  Result<void> begin() {
    double seconds = wanted_seconds();
    if (lost_) seconds = std::min(seconds, static_cast<double>(captured_us_) / 1e6);
    if (seconds == 0)
      return fail(ErrorCode::kInvalidArgument, "nothing moves in " + options_.scene.streams.front() +
                                                   ": say --seconds, --turntable or --camera-path");
    const auto clock = FilmClock::create(seconds, options_.film->fps);
    if (!clock) return clock.error();
    clock_ = *clock;
    auto good = store(context_, OffscreenContext::create());
    if (good) good = store(renderer_, Renderer::create());
    // "auto" measures, and two films would not be the same to the bit.
    const bool on_gpu = options_.reconstruct == RebuildOn::kGpu;
    if (good) good = store(rebuilder_, choose_rebuilder(on_gpu ? RebuildOn::kGpu : RebuildOn::kCpu, *renderer_, true));
    for (const auto& source : opened_) sources_.push_back(source.get());
    if (good) good = store(session_, Session::create(options_, sources_, log_));
    if (!good) return good;
    session_->rebuild_with(rebuilder_);
    if (options_.hud)
      overlay_ = std::make_unique<Overlay>(nullptr, text_scale(1, 1, static_cast<float>(options_.ui_scale)));
    camera_.set_viewport(options_.width, options_.height);
    camera_.set_view(options_.view);
    return {};
  }

  /// Ends with what is there when the program is to stop.
  Result<void> draw_all() {
    ProgressLine line = progress();
    const auto total = static_cast<double>(clock_->pictures());
    for (; drawn_ < clock_->pictures() && line(static_cast<double>(drawn_) / total, "drawing"); ++drawn_) {
      film_us_ = clock_->time_us(drawn_);
      session_->update({}, camera_, film_us_);
      if (path_)
        path_->apply(static_cast<double>(film_us_) / 1e6, camera_);
      else if (options_.turntable_s > 0 && drawn_ > 0)
        camera_.turn(static_cast<float>(kFullTurn / (options_.turntable_s * clock_->fps())));
      if (const auto written = writer_->add(picture()); !written) return written;
      session_->count_written();
    }
    if (drawn_ == 0) return cancelled();
    if (const std::string why = session_->colours().why_not(); !why.empty())
      log(log_, LogLevel::kWarning, "colours are not as asked for: " + why);
    if (drawn_ < clock_->pictures()) log(log_, LogLevel::kWarning, "stopped: the film ends early");
    return {};
  }

  Picture picture() {
    const unsigned target = renderer_->offscreen_target(options_.width, options_.height);
    session_->draw(*renderer_, camera_, options_.style, options_.width, options_.height, target);
    if (overlay_) {
      OverlayContent legend;  // other figures are of this machine's time
      legend.legend = session_->overlay_content().legend;
      overlay_->draw(legend, options_.width, options_.height, target);
    }
    session_->finish_picture(true);
    return Renderer::read_back(options_.width, options_.height, target, options_.style.transparent);
  }

  const ClientOptions& options_;
  const std::atomic<bool>& stop_;
  const LogSink& log_;
  std::optional<CameraPath> path_;
  std::unique_ptr<FilmWriter> writer_;
  TimeUs film_us_ = 0;                               ///< What the clips show.
  std::vector<std::unique_ptr<PoseSource>> opened_;  ///< One for each stream.
  std::vector<std::size_t> captured_;                ///< Streams of brokers.
  TimeUs longest_us_ = 0;                            ///< Period of a clip.
  TimeUs captured_us_ = 0;
  bool lost_ = false;
  std::optional<FilmClock> clock_;
  // The context goes last: the members below need it current when destroyed.
  std::unique_ptr<OffscreenContext> context_;
  std::unique_ptr<Renderer> renderer_;
  RebuilderChoice rebuilder_;
  std::unique_ptr<Overlay> overlay_;
  std::vector<PoseSource*> sources_;
  std::unique_ptr<Session> session_;
  Camera camera_;
  std::uint64_t drawn_ = 0;
};

}  // namespace

int run_film(const ClientOptions& options, const std::atomic<bool>& stop, const LogSink& log_sink) {
  Film film(options, stop, log_sink);
  const Result<int> code = film.run();
  return code ? *code : failed(code.error(), log_sink);
}

}  // namespace eigencast
