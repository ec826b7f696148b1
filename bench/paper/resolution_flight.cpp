// SPDX-License-Identifier: MIT
//
// Figures 6 and 7 of Zhang et al. 2013: deforming surfaces that a camera flies around, with and without control of
// their levels of detail. Uses the client's own scene, resolvers and renderer; the picture's time is what it took to
// make.
//
// The flight's clock is the sum of those times: what is measured beside it (the picture of full detail to compare with)
// does not delay it, and every run sees the same flight.
#include <CLI/CLI.hpp>
#include <cmath>
#include <cstdio>
#include <glm/ext/matrix_transform.hpp>
#include <numeric>
#include <random>

#include "client/clip_source.h"
#include "client/level_control.h"
#include "client/scene_file.h"
#include "view/renderer.h"
#include "view/scene.h"

namespace eigencast {
namespace {

struct Settings {
  std::string clip = "heart", cache, flight, resolver = "none";
  int count = 6, width = 640, height = 480, compare_every = 0, changes_every = 0;
  double f0 = 20, near = 0.5, far = 6, floor = 0.02, deadline = 1.25;  // as headless: no display is missed
  bool model = false, busy = false, at_once = false;
};

/// Mean structural similarity of two pictures' brightness (Wang, Bovik, Sheikh, Simoncelli 2004, "Image quality
/// assessment"), over windows of 8 x 8 pixels, 4 apart.
double similarity(const Picture& a, const Picture& b) {
  constexpr int kSide = 8, kStep = 4;
  constexpr double kC1 = 0.01 * 255 * 0.01 * 255, kC2 = 0.03 * 255 * 0.03 * 255, kCount = kSide * kSide;
  const auto grey = [](const std::uint8_t* p) { return 0.299 * p[0] + 0.587 * p[1] + 0.114 * p[2]; };
  double sum = 0;
  int windows = 0;
  for (int y = 0; y + kSide <= a.height; y += kStep) {
    for (int x = 0; x + kSide <= a.width; x += kStep, ++windows) {
      double sa = 0, sb = 0, saa = 0, sbb = 0, sab = 0;
      for (int j = 0; j < kSide; ++j) {
        for (int i = 0; i < kSide; ++i) {
          const double u = grey(a.pixel(x + i, y + j)), v = grey(b.pixel(x + i, y + j));
          sa += u, sb += v, saa += u * u, sbb += v * v, sab += u * v;
        }
      }
      const double ma = sa / kCount, mb = sb / kCount;
      const double va = saa / kCount - ma * ma, vb = sbb / kCount - mb * mb, vab = sab / kCount - ma * mb;
      sum += (2 * ma * mb + kC1) * (2 * vab + kC2) / ((ma * ma + mb * mb + kC1) * (va + vb + kC2));
    }
  }
  return sum / windows;
}

/// How two pictures differ.
struct Difference {
  double mean = 0;  ///< Covers all channels, of 255.
  double part = 0;  ///< Share of the pixels that differ by more than kSeen.
  static constexpr int kSeen = 3;
};

Difference difference(const Picture& a, const Picture& b) {
  Difference d;
  for (std::size_t i = 0; i < a.rgb.size(); i += 3) {
    int most = 0;
    for (std::size_t c = i; c < i + 3; ++c) {
      const int by = std::abs(int{a.rgb[c]} - int{b.rgb[c]});
      d.mean += by;
      most = std::max(most, by);
    }
    d.part += most > Difference::kSeen ? 1 : 0;
  }
  d.mean /= static_cast<double>(a.rgb.size());
  d.part /= static_cast<double>(a.rgb.size() / 3);
  return d;
}

/// A machine that takes the same time on every run, whatever else runs beside it: 8 ms, 45 ms for all vertices, 6 ms
/// for surfaces that fill the picture, and noise of 6 %. Busy it takes 1.7 times that with noise of 15 %, and each 33rd
/// picture three times as long.
class ModelMachine {
 public:
  TimeUs work_us(const Scene& scene, const Camera& camera, const Settings& settings, double all_vertices) {
    const double picture = static_cast<double>(settings.width) * settings.height;
    double covered = 0;
    for (const Scene::Instance& instance : scene.instances()) {
      const Extent extent = extent_of(instance);
      const double diameter = camera.diameter_px(extent.barycentre, extent.radius);
      covered += std::min(diameter * diameter, picture) / picture;
    }
    const double part = static_cast<double>(scene.vertex_count()) / all_vertices;
    const double noise = std::exp((settings.busy ? 0.15 : 0.06) * normal_(random_));
    const double spike = settings.busy && ++pictures_ % 33 == 0 ? 3 : 1;
    return static_cast<TimeUs>((settings.busy ? 1.7 : 1) * (8000 + 45'000 * part + 6000 * covered) * noise * spike);
  }

 private:
  std::mt19937 random_{3};
  std::normal_distribution<double> normal_;
  int pictures_ = 0;
};

class Flight {
 public:
  Flight(const Settings& settings, std::shared_ptr<const BakedClip> clip, CameraPath path)
      : settings_(settings),
        path_(std::move(path)),
        all_vertices_(static_cast<double>(clip->asset.vertex_count) * settings.count),
        scene_(placements(settings, clip->asset), {.playout = {}, .morph = !settings.at_once}),
        full_(placements(settings, clip->asset), {.playout = {}, .morph = false}),
        levels_(level_settings(settings)) {
    for (std::vector<PoseSource*>* list : {&list_, &full_list_}) {
      for (int i = 0; i < settings.count; ++i) {
        sources_.push_back(std::make_unique<ClipSource>(clip, 0.11 * i, [this] { return now_us_; }));
        list->push_back(sources_.back().get());
      }
    }
    camera_.set_viewport(settings.width, settings.height);
  }

  void fly(Renderer& renderer) {
    renderer.set_surface_count(list_.size());
    warm_up(renderer);
    std::printf("t_s,work_ms,state,mean_lod,similarity,error,change_mean,change_part,motion_mean,motion_part");
    for (int i = 0; i < settings_.count; ++i) std::printf(",lod_%d", i);
    std::printf("\n");
    std::optional<FrameWork> last;
    for (int frame = 0; static_cast<double>(now_us_) / 1e6 < path_.seconds(); ++frame) {
      const TimeUs began_us = now_us_, start = steady_now_us();
      take_poses(scene_, list_);
      path_.apply(static_cast<double>(now_us_) / 1e6, camera_);
      const bool changes = settings_.changes_every > 0 && frame > 0 && frame % settings_.changes_every == 0;
      const Picture as_before = changes ? with_levels_as_before(renderer) : Picture{};
      levels_.choose(scene_, list_, camera_, last);
      scene_.advance(list_, now_us_);
      const bool compare = settings_.compare_every > 0 && frame % settings_.compare_every == 0;
      // A model needs pictures for what is compared alone.
      if (!settings_.model || compare || settings_.changes_every > 0) draw(renderer, scene_);
      const TimeUs work =
          settings_.model ? machine_.work_us(scene_, camera_, settings_, all_vertices_) : steady_now_us() - start;
      const std::vector<double> lod = levels_now();
      const Picture shown = settings_.changes_every > 0 ? shown_now(renderer) : Picture{};
      const FromFull from_full = compare ? compared_to_full(renderer) : FromFull();
      before_us_ = now_us_;
      now_us_ += work;
      last = FrameWork{now_us_, static_cast<double>(work) / 1e6};
      std::printf("%.6f,%.3f,%.5f,%.5f,", static_cast<double>(began_us) / 1e6, static_cast<double>(work) / 1e3,
                  levels_.state(), std::accumulate(lod.begin(), lod.end(), 0.0) / static_cast<double>(lod.size()));
      if (compare) std::printf("%.6f", from_full.similarity);
      std::printf(",");
      if (compare) std::printf("%.5f", from_full.error);
      if (changes) {
        const Difference levels = difference(as_before, shown), motion = difference(last_shown_, as_before);
        std::printf(",%.5f,%.5f,%.5f,%.5f", levels.mean, levels.part, motion.mean, motion.part);
      } else {
        std::printf(",,,,");
      }
      last_shown_ = shown;
      for (const double each : lod) std::printf(",%.4f", each);
      std::printf("\n");
    }
  }

 private:
  /// Two rows on the ground, each surface one unit from corner to corner, all facing along the first axis.
  static std::vector<Placement> placements(const Settings& settings, const Asset& asset) {
    std::vector<Placement> all;
    const auto scale = static_cast<float>(1 / asset.diagonal());
    const int columns = (settings.count + 1) / 2;
    for (int i = 0; i < settings.count; ++i) {
      const float column = static_cast<float>(i % columns) - 0.5F * static_cast<float>(columns - 1);
      const glm::vec3 centre(1.1F * column, 0, i < columns ? -0.45F : 0.45F);
      all.push_back(
          {static_cast<std::size_t>(i), "", glm::scale(glm::translate(glm::mat4(1), centre), glm::vec3(scale))});
    }
    return all;
  }

  static LevelSettings level_settings(const Settings& settings) {
    LevelSettings levels;
    levels.kind = settings.resolver == "paper"    ? ResolverKind::kPaper
                  : settings.resolver == "budget" ? ResolverKind::kBudget
                                                  : ResolverKind::kNone;
    levels.target_fps = settings.f0;
    levels.near = settings.near;
    levels.far = settings.far;
    levels.floor = settings.floor;
    levels.deadline = settings.deadline;
    return levels;
  }

  static void take_poses(Scene& scene, std::span<PoseSource* const> list) {
    for (std::size_t i = 0; i < list.size(); ++i) scene.receive(i, *list[i], list[i]->poll({}));
  }

  void draw(Renderer& renderer, const Scene& scene) {
    for (std::size_t i = 0; i < list_.size(); ++i) {
      renderer.upload(i, scene.instances()[i].view.geometry());
      renderer.place(i, scene.instances()[i].scene_from_surface);
    }
    const unsigned target = renderer.offscreen_target(settings_.width, settings_.height);
    renderer.draw(camera_, {}, settings_.width, settings_.height, target);
    Renderer::finish();
  }

  /// Drivers compile shaders when they are first used.
  void warm_up(Renderer& renderer) {
    take_poses(scene_, list_);
    scene_.advance(list_, now_us_);
    const SurfaceFacts& f = scene_.facts();
    camera_.set_scene(f.low, f.high, f.outline);
    for (int i = 0; i < 3; ++i) draw(renderer, scene_);
  }

  std::vector<double> levels_now() const {
    std::vector<double> lod;
    for (std::size_t i = 0; i < list_.size(); ++i)
      lod.push_back(static_cast<double>(scene_.instances()[i].view.geometry().vertex_count()) /
                    list_[i]->asset()->vertex_count);
    return lod;
  }

  Picture shown_now(Renderer& renderer) const {
    return Renderer::read_back(settings_.width, settings_.height,
                               renderer.offscreen_target(settings_.width, settings_.height));
  }

  /// The poses and the view of now; the levels, and how far their vertices have come, of the picture before.
  Picture with_levels_as_before(Renderer& renderer) {
    scene_.advance(list_, before_us_);
    draw(renderer, scene_);
    return shown_now(renderer);
  }

  /// To the picture of full detail.
  struct FromFull {
    double similarity = 1, error = 0;  ///< error: mean over all channels, of 255.
  };
  FromFull compared_to_full(Renderer& renderer) {
    const Picture shown = shown_now(renderer);
    take_poses(full_, full_list_);
    full_.advance(full_list_, now_us_);
    draw(renderer, full_);
    const Picture full = shown_now(renderer);
    return {similarity(shown, full), difference(shown, full).mean};
  }

  const Settings settings_;
  const CameraPath path_;
  const double all_vertices_;
  ModelMachine machine_;
  TimeUs now_us_ = 0, before_us_ = 0;
  Picture last_shown_;  ///< If changes are measured.
  std::vector<std::unique_ptr<ClipSource>> sources_;
  std::vector<PoseSource*> list_, full_list_;
  Scene scene_;
  Scene full_;  ///< At full detail, to compare with.
  LevelControl levels_;
  Camera camera_;
};

Result<void> run(const Settings& settings) {
  auto path = CameraPath::read(settings.flight);
  if (!path) return path.error();
  const auto clip = BakedClip::open(settings.clip, settings.cache);
  if (!clip) return clip.error();
  const auto context = OffscreenContext::create();
  if (!context) return context.error();
  const auto renderer = Renderer::create();
  if (!renderer) return renderer.error();
  std::fprintf(stderr, "%s: %u vertices x %d, %dx%d pixels, %s\n", settings.clip.c_str(), (*clip)->asset.vertex_count,
               settings.count, settings.width, settings.height, (*renderer)->device().c_str());
  Flight(settings, *clip, std::move(path->value())).fly(**renderer);
  return {};
}

}  // namespace
}  // namespace eigencast

int main(int argc, char** argv) {
  eigencast::Settings settings;
  CLI::App app{
      "Flies around deforming surfaces and writes, for each picture, what it took and which levels were drawn (CSV)."};
  app.add_option("--clip", settings.clip)->capture_default_str();
  app.add_option("--count", settings.count)->check(CLI::Range(1, 256))->capture_default_str();
  app.add_option("--flight", settings.flight, "camera path (JSON)")->required();
  app.add_option("--resolver", settings.resolver)
      ->check(CLI::IsMember({"none", "paper", "budget"}))
      ->capture_default_str();
  app.add_option("--f0", settings.f0)->capture_default_str();
  app.add_option("--near", settings.near, "of the paper's resolver: distance of full detail")->capture_default_str();
  app.add_option("--far", settings.far, "and of none")->capture_default_str();
  app.add_option("--floor", settings.floor)->capture_default_str();
  app.add_option("--deadline", settings.deadline, "of the budget resolver: pictures' times after which one is late")
      ->capture_default_str();
  app.add_flag("--at-once", settings.at_once, "levels change from one picture to the next, not smoothly");
  app.add_flag("--model", settings.model, "pictures take what a model says, so that every run is the same");
  app.add_flag("--busy", settings.busy, "with --model: beside other programs")->needs("--model");
  app.add_option("--width", settings.width)->capture_default_str();
  app.add_option("--height", settings.height)->capture_default_str();
  app.add_option("--compare-every", settings.compare_every, "pictures; 0: none")->capture_default_str();
  app.add_option(
         "--changes-every", settings.changes_every,
         "pictures, for which it prints what levels alone have changed since the one before, and what motion has; "
         "with --model: it takes time (0: none)")
      ->capture_default_str();
  app.add_option("--cache", settings.cache, "folder of baked assets");
  CLI11_PARSE(app, argc, argv);
  if (settings.changes_every > 0 && !settings.model) {
    std::fprintf(stderr, "--changes-every takes time from the pictures that it compares: give --model as well\n");
    return 2;
  }
  if (const auto done = eigencast::run(settings); !done) {
    std::fprintf(stderr, "%s\n", done.error().message.c_str());
    return 1;
  }
  return 0;
}
