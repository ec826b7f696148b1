// SPDX-License-Identifier: MIT
#include <algorithm>
#include <filesystem>
#include <numeric>
#include <utility>

#include "client/apps.h"
#include "client/hud_text.h"
#include "client/offscreen_viewer.h"
#include "client/patience.h"
#include "client/scene_file.h"
#include "client/stream_capture.h"
#include "common/core/clock.h"
#include "common/core/files.h"
#include "common/core/text.h"

namespace eigencast {
namespace {

std::vector<std::size_t> numbers_below(std::size_t count) {
  std::vector<std::size_t> numbers(count);
  std::iota(numbers.begin(), numbers.end(), std::size_t{0});
  return numbers;
}

class Headless {
 public:
  Headless(const ClientOptions& options, std::size_t sources, const LogSink& log)
      : options_(options), log_(log), patience_(options, numbers_below(sources)) {}

  Result<void> open(std::span<PoseSource* const> sources) {
    auto good = store(path_, CameraPath::read(options_.camera_path));
    if (good) good = store(viewer_, OffscreenViewer::open(options_, options_.reconstruct, sources, log_));
    if (!good || options_.out.empty()) return good;
    std::error_code error;
    std::filesystem::create_directories(options_.out, error);
    if (error) return fail(ErrorCode::kIo, options_.out + ": cannot make the folder: " + error.message());
    return {};
  }

  Result<int> run(const std::atomic<bool>& stop) {
    // After the start of the renderer, whose threads must not inherit this.
    run_when_woken(kMakingPoses);
    const TimeUs start = steady_now_us();
    bool gone = false;
    while (!stop.load()) {
      const double seconds = static_cast<double>(steady_now_us() - start) / 1e6;
      if (options_.duration_s > 0 && seconds >= options_.duration_s) break;
      if (options_.frames > 0 && taken_ >= options_.frames) break;
      const bool has_begun = session().scene().poses_shown() > 0 && !waits_for_all();
      if (taken_ == 0 && patience_.is_over(session().sources(), has_begun, steady_now_us())) return report_no_stream();
      if (flight_is_over() || (gone = senders_are_gone())) break;
      const bool changed = session().update(std::chrono::milliseconds(flying() ? 0 : 20), viewer_->camera());
      const bool is_led = changed && session().room() != nullptr;  // Who leads moves the camera between poses too.
      if (taken_ == 0 && waits_for_all() && !is_whole()) continue;
      if (const std::string notice = session().rewind().take_notice(); !notice.empty())
        log(log_, LogLevel::kWarning, notice);
      std::string trouble = session().rewind().take_trouble();
      if (session().rewind().is_settled()) settled_us_ = steady_now_us();
      if (!session().rewind().is_settled()) {
        if (static_cast<double>(steady_now_us() - settled_us_) / 1e6 > options_.wait_s)
          trouble = "the broker does not say what it keeps of it";
        shown_ = session().scene().poses_shown();
        if (trouble.empty()) continue;
      }
      if (!trouble.empty() && options_.ago_s > 0) {
        log(log_, LogLevel::kError, "--ago: " + trouble);
        return kExitNoStream;
      }
      if (!trouble.empty()) log(log_, LogLevel::kWarning, "who leads is in the past: " + trouble);
      if (session().scene().poses_shown() == shown_ && !flying() && !(is_led && taken_ > 0)) continue;
      shown_ = session().scene().poses_shown();
      if (const Result<void> taken = take_picture(); !taken) return taken.error();
    }
    if (const Result<void> written = write_results(); !written) return written.error();
    if (taken_ == 0 && !stop.load()) return report_no_stream();
    if (!gone) return kExitGood;
    log(log_, LogLevel::kError,
        what_is_gone() + ": " + std::to_string(taken_) + " of " + std::to_string(options_.frames) +
            " pictures; --wait gives it longer to come back");
    return kExitNoStream;
  }

 private:
  Session& session() const { return viewer_->session(); }
  /// A number of pictures is meant of the whole surfaces.
  bool waits_for_all() const { return !options_.first && options_.frames > 0; }
  /// All has come, has moved to its place and has its colours.
  bool is_whole() const {
    const auto& sources = session().sources();
    const auto& surfaces = session().scene().instances();
    return std::all_of(sources.begin(), sources.end(), [](const auto* source) { return has_whole_surface(*source); }) &&
           !session().is_fading() && std::all_of(surfaces.begin(), surfaces.end(), [](const auto& surface) {
             return surface.view.morph().moving().empty();
           });
  }

  /// Pictures are missing, and for as long as it waits nothing is new and nobody sends.
  bool senders_are_gone() const {
    if (taken_ == 0 || taken_ >= options_.frames ||
        static_cast<double>(steady_now_us() - taken_us_) / 1e6 < options_.wait_s)
      return false;
    const auto sends = [](const PoseSource* source) {
      const Subscriber::State state = source->stats().state;
      return state == Subscriber::State::kLive || state == Subscriber::State::kDownloading;
    };
    return std::none_of(session().sources().begin(), session().sources().end(), sends);
  }

  std::string what_is_gone() const {
    const auto& sources = session().sources();
    const auto lost = std::find_if(sources.begin(), sources.end(), [](const PoseSource* source) {
      const Subscriber::State state = source->stats().state;
      return state == Subscriber::State::kLost || state == Subscriber::State::kConnecting;
    });
    if (lost == sources.end()) return "the sender is gone";
    return "the broker is gone (" + text_from_state((*lost)->stats()) + ")";
  }

  bool flying() const { return path_ && flight_began_us_; }
  double flown_s() const { return flying() ? static_cast<double>(steady_now_us() - *flight_began_us_) / 1e6 : 0; }
  bool flight_is_over() const { return flying() && flown_s() > path_->seconds(); }

  Result<void> take_picture() {
    if (path_) path_->apply(flown_s(), viewer_->camera());
    if (!flight_began_us_) flight_began_us_ = steady_now_us();
    viewer_->draw([this] { return session().overlay_content(); });
    ++taken_;
    taken_us_ = steady_now_us();
    if (options_.out.empty()) return {};
    const std::string name = formatted("frame_%04llu.png", static_cast<unsigned long long>(taken_));
    const Result<void> written = write_png((std::filesystem::path(options_.out) / name).string(), viewer_->picture());
    if (written) session().count_written();
    return written;
  }

  Result<void> write_results() {
    if (!options_.screenshot.empty() && taken_ > 0) {
      if (const Result<void> written = write_png(options_.screenshot, viewer_->picture()); !written) return written;
    }
    std::string path = options_.json;
    if (path.empty() && !options_.out.empty()) path = (std::filesystem::path(options_.out) / "report.json").string();
    const std::string report = viewer_->report();
    const HudFigures f = session().figures();
    if (const std::string why = session().colours().why_not(); !why.empty())
      log(log_, LogLevel::kWarning, "colours are not as asked for: " + why);
    log(log_, LogLevel::kInfo,
        std::to_string(taken_) + " pictures drawn, at last " + std::to_string(f.vertices) + " of " +
            std::to_string(f.vertices_total) + " vertices" + (path.empty() ? "" : ", report: " + path));
    return path.empty() ? Result<void>() : write_file_atomically(path, report);
  }

  int report_no_stream() {
    log(log_, LogLevel::kError, patience_.reason(session().sources()));
    return kExitNoStream;
  }

  const ClientOptions& options_;
  const LogSink& log_;
  std::unique_ptr<OffscreenViewer> viewer_;
  std::optional<CameraPath> path_;
  std::optional<TimeUs> flight_began_us_;
  std::uint64_t taken_ = 0, shown_ = 0;
  TimeUs taken_us_ = 0, settled_us_ = steady_now_us();
  Patience patience_;
};

}  // namespace

int run_headless(const ClientOptions& options, std::span<PoseSource* const> sources, const std::atomic<bool>& stop,
                 const LogSink& log_sink) {
  Headless headless(options, sources.size(), log_sink);
  if (const Result<void> ready = headless.open(sources); !ready) return failed(ready.error(), log_sink);
  const Result<int> code = headless.run(stop);
  return code ? *code : failed(code.error(), log_sink);
}

}  // namespace eigencast
