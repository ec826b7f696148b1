// SPDX-License-Identifier: MIT
#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>

#include "common/core/files.h"
#include "common/core/histogram.h"
#include "common/surface/formats/write.h"
#include "sender/commands.h"
#include "sender/console.h"
#include "sender/deform/arap.h"
#include "sender/deform/deformer.h"
#include "sender/deform/script.h"
#include "sender/live.h"
#include "sender/pose_stream.h"
#include "sender/surface_error.h"

namespace eigencast {
namespace {

using deform::Deformer;
using deform::ProjectedDeformer;
using deform::Script;

constexpr std::uintmax_t kMaxScriptBytes = 64 << 20;

struct Plan {
  OpenedSource model;
  std::unique_ptr<Deformer> deformer;       ///< Null: by hand among the shapes of the basis, for which `groups` wait.
  std::vector<deform::HandleGroup> groups;  ///< Handles; empty: a cage.
  std::optional<Script> script;             ///< Nothing: by hand.
};

Result<std::vector<deform::HandleGroup>> read_handles(const std::string& path, const Surface& model) {
  const auto text = read_file(path, kMaxScriptBytes);
  if (!text) return text.error();
  auto groups = deform::handle_groups_from_json(*text, model);
  if (!groups) return in_context(path, groups.error());
  const auto usable = deform::check_handles(*groups, model.vertex_count(), model.faces.size());
  if (!usable) return in_context(path, usable.error());
  spdlog::info("{} handles", groups->size());
  return groups;
}

Result<Surface> make_cage(const DeformCommand& command, const Surface& model) {
  auto cage = cage_of(command.source.cage, model);
  if (!cage) return cage;
  spdlog::info("cage: {} vertices, {} faces", cage->vertex_count(), cage->faces.size());
  if (command.cage_out.empty()) return cage;
  if (const auto written = write_surface(*cage, command.cage_out); !written) return written.error();
  return cage;
}

Result<std::unique_ptr<Deformer>> in_cage(const DeformCommand& command, const Surface& model, Surface cage,
                                          const Console& console, Interrupt& interrupt) {
  ProgressLine line(console.progress, stops_at(interrupt));
  return bind_cage(command.source.cage, model, std::move(cage),
                   [&](double fraction) { return line(fraction, "binding the model to its cage"); });
}

Result<Script> script_of(const std::string& what, std::span<const Vec3> handles) {
  std::error_code ignored;
  const bool is_word = what.find_first_of("/.") == std::string::npos;
  if (is_word && !std::filesystem::exists(what, ignored)) return Script::builtin(what, handles);
  const auto text = read_file(what, kMaxScriptBytes);
  if (!text) return text.error();
  auto script = Script::from_json(*text, handles);
  if (!script) return in_context(what, script.error());
  return script;
}

/// What does not need the basis, so that its errors are reported before the bake.
Result<Plan> plan_of(const DeformCommand& command, const Console& console, Interrupt& interrupt) {
  if (command.script.empty()) {
    if (const auto window = find_display(); !window) return window.error();
  }
  auto clip = open_source(command.source);
  if (!clip) return clip.error();
  const Surface& model = (*clip)->rest();
  const bool has_cage = command.handles.empty();
  Plan plan;
  Surface cage;
  if (has_cage) {
    if (const auto good = store(cage, make_cage(command, model)); !good) return good.error();
  } else {
    if (const auto good = store(plan.groups, read_handles(command.handles, model)); !good) return good.error();
  }
  if (!command.script.empty()) {
    auto script =
        script_of(command.script, has_cage ? cage.positions : deform::centres_of(plan.groups, model.positions));
    if (!script) return script.error();
    plan.script = std::move(*script);
  }
  if (has_cage || plan.script) {
    if (const auto good = store(plan.deformer, has_cage ? in_cage(command, model, std::move(cage), console, interrupt)
                                                        : deform::arap_deformer(model, plan.groups));
        !good)
      return good.error();
  }
  plan.model = {std::move(*clip), has_cage ? plan.deformer.get() : nullptr};
  return plan;
}

class ScriptRun {
 public:
  ScriptRun(const DeformCommand& command, Deformer& deformer, ProjectedDeformer projected, const Script& script)
      : command_(command), deformer_(deformer), projected_(std::move(projected)), script_(script) {}

  Result<void> run(Publisher& publisher, Interrupt& interrupt) {
    const TimeUs start_us = steady_now_us();
    StatusLog status(start_us);
    Schedule schedule(options(), start_us);
    while (const auto tick = schedule.next(steady_now_us())) {
      // Until it is due there is nothing to do: what is sent is then as new as can be.
      if (interrupt.wait_until(tick->due_us)) break;
      const std::int64_t begin_us = steady_now_us();
      const auto C = projected_.coefficients(handles_at(tick->due_us - start_us));
      if (!C) return C.error();
      if (const auto ours = check_ownership(publisher); !ours) return ours;
      (void)publisher.send_coefficients(*C, tick->due_us);  // It counts what it drops.
      pose_us_.add(steady_now_us() - begin_us);
      status.show(publisher, steady_now_us());
    }
    skipped_ = schedule.skipped();
    return {};
  }

  /// Over one turn of the script.
  Result<SurfaceError> error(const Asset& asset) {
    constexpr int kPoses = 24;
    SurfaceErrorSum sum(asset.diagonal());
    SourceRebuilder rebuilder(asset);
    for (int i = 0; i < kPoses; ++i) {
      const std::vector<Vec3> handles = script_.handles_at(script_.duration_s() * i / kPoses);
      const auto C = projected_.coefficients(handles);
      if (!C) return C.error();
      sum.add(deformer_.positions(handles), rebuilder.rebuild(*C, 3));
    }
    return sum.result();
  }
  const Histogram& pose_us() const { return pose_us_; }
  std::uint64_t skipped() const { return skipped_; }

 private:
  std::vector<Vec3> handles_at(TimeUs since_us) const {
    return script_.handles_at(static_cast<double>(since_us) * 1e-6 * command_.speed);
  }
  Schedule::Options options() const {
    Schedule::Options options;
    options.rate_hz = options.clip_rate_hz = command_.rate_hz;
    options.frames = ~std::size_t{0} >> 32;
    options.max_ticks = command_.frames;
    double seconds = command_.duration_s;
    if (seconds == 0 && (command_.once || !script_.loops())) seconds = script_.duration_s() / command_.speed;
    if (seconds > 0) {
      const auto ticks = static_cast<std::uint64_t>(std::floor(seconds * command_.rate_hz)) + 1;
      options.max_ticks = options.max_ticks > 0 ? std::min(options.max_ticks, ticks) : ticks;
    }
    return options;
  }

  const DeformCommand& command_;
  Deformer& deformer_;
  ProjectedDeformer projected_;
  const Script& script_;
  Histogram pose_us_;
  std::uint64_t skipped_ = 0;
};

Result<std::string> by_script(const DeformCommand& command, Deformer& deformer, ProjectedDeformer projected,
                              const Script& script, const Asset& asset, Publisher& publisher, Interrupt& interrupt) {
  ScriptRun script_run(command, deformer, std::move(projected), script);
  const auto error = script_run.error(asset);
  if (!error) return error.error();
  spdlog::info("what is sent lies {:.2e} (rms), {:.2e} (largest) of the diagonal from the full deformation", error->rms,
               error->max);
  const TimeUs deadline_us =
      command.duration_s > 0 ? steady_now_us() + static_cast<TimeUs>(command.duration_s * 1e6) : 0;
  if (!wait_until_live(publisher, deadline_us, interrupt) && !interrupt.requested()) {
    if (const auto ours = check_ownership(publisher); !ours) return ours.error();
    return fail(ErrorCode::kUnreachable, "no pose was sent: the broker is not live: " + publisher.stats().detail);
  }
  if (const auto ran = script_run.run(publisher, interrupt); !ran) return ran.error();
  const Publisher::Stats stats = publisher.stats();
  const nlohmann::json report{{"frames_sent", stats.frames_sent},
                              {"frames_dropped", stats.frames_dropped},
                              {"frames_skipped", script_run.skipped()},
                              {"bytes", stats.payload_bytes},
                              {"frames_recalled", stats.frames_recalled},
                              {"memory_bytes", stats.memory_bytes},
                              {"saved_bytes", stats.saved_bytes},
                              {"handles", deformer.handles().size()},
                              {"rms_over_diagonal", error->rms},
                              {"max_over_diagonal", error->max},
                              {"pose_us_p50", script_run.pose_us().percentile(50)},
                              {"pose_us_p99", script_run.pose_us().percentile(99)}};
  return report.dump(2);
}

Result<std::string> perform(const DeformCommand& command, Plan plan, Source source, Interrupt& interrupt) {
  const auto asset = std::make_shared<const Asset>(std::move(source.baked.asset));
  if (plan.deformer == nullptr) {
    if (const auto good = store(plan.deformer, deform::reduced_arap_deformer(*asset, plan.groups)); !good)
      return good.error();
  }
  const auto projector = Projector::create(*asset);
  if (!projector) return projector.error();
  auto projected = ProjectedDeformer::create(*plan.deformer, *asset, *projector);
  if (!projected) return projected.error();
  const auto publisher = publish(command.target, command.rate_hz, asset,
                                 std::make_shared<const EncodedAsset>(std::move(source.baked.encoded)));
  if (!publisher) return publisher.error();
  auto report = plan.script ? by_script(command, *plan.deformer, std::move(*projected), *plan.script, *asset,
                                        **publisher, interrupt)
                            : deform_by_hand(command, *plan.deformer, *projected, *asset, **publisher, interrupt);
  const Publisher::Stats stats = (*publisher)->stats();
  spdlog::info("sent {} poses, {} dropped", stats.frames_sent, stats.frames_dropped);
  return report;
}

}  // namespace

int run(const DeformCommand& given, const Console& console, Interrupt& interrupt) {
  DeformCommand command = given;
  if (command.rate_hz == 0) command.rate_hz = command.script.empty() ? 60 : 30;
  if (const ExitCode usable = check_target(command.target); usable != kExitOk) return usable;
  auto plan = plan_of(command, console, interrupt);
  if (!plan) return report_failure(plan.error());
  auto source = bake_with_progress(command.source, console, interrupt, std::move(plan->model));
  if (!source) return report_failure(source.error());
  const auto report = perform(command, std::move(*plan), std::move(*source), interrupt);
  if (!report) return report_failure(report.error());
  return end_with_report(command.json, *report);
}

}  // namespace eigencast
