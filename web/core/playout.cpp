// SPDX-License-Identifier: MIT
#include "common/motion/playout.h"

#include <cmath>
#include <optional>
#include <vector>

#include "common/wire/limits.h"
#include "web/core/core.h"
#include "web/core/error.h"

struct core_playout {
  eigencast::Playout playout;
  std::optional<eigencast::PlayoutPose> pose;
  core_shown shown{};
};

using namespace eigencast;

namespace {

Result<PlayoutPose> pose_from(TimeUs time_us, const double* coefficients, uint32_t count, uint32_t bands, Shown shown) {
  if (count > limits::kMaxCoefficients) return fail(ErrorCode::kTooLarge, "a pose has at most 32,768 coefficients");
  PlayoutPose pose;
  pose.time_us = time_us;
  pose.coefficients = std::vector<double>(coefficients, coefficients + count);
  pose.bands = static_cast<std::uint8_t>(bands);
  pose.shown = shown;
  return pose;
}

}  // namespace

core_playout* playout_make() {
  return new core_playout;
}

void playout_free(core_playout* playout) {
  delete playout;
}

int32_t playout_set(core_playout* playout, uint32_t mode, double smoothness, int64_t delay_us, int64_t max_ahead_us) {
  if (mode > static_cast<uint32_t>(PlayoutMode::kEstimate) || delay_us < 0 || max_ahead_us < 0)
    return web::failed(fail(ErrorCode::kInvalidArgument, "there is no such play-out"));
  PlayoutSettings settings;
  settings.mode = static_cast<PlayoutMode>(mode);
  if (!std::isnan(smoothness)) settings.smoothness = smoothness;
  settings.delay_us = bounded_time(delay_us);
  settings.max_ahead_us = bounded_time(max_ahead_us);
  playout->playout.set(settings);
  return 0;
}

int32_t playout_bands(core_playout* playout, const uint32_t* band_ends, uint32_t bands) {
  if (bands > CORE_MAX_BANDS) return web::failed(fail(ErrorCode::kInvalidArgument, "there are too many bands"));
  playout->playout.set_band_ends({band_ends, bands});
  return 0;
}

int32_t playout_add(core_playout* playout, int64_t time_us, int64_t arrival_us, const double* coefficients,
                    uint32_t count, uint32_t bands, uint32_t is_estimate) {
  auto pose = pose_from(time_us, coefficients, count, bands, is_estimate != 0 ? Shown::kEstimated : Shown::kLive);
  if (!pose) return web::failed(pose.error());
  return playout->playout.add(*std::move(pose), arrival_us) ? 1 : 0;
}

int32_t playout_add_next(core_playout* playout, int64_t time_us, const double* coefficients, uint32_t count,
                         uint32_t bands) {
  auto key = pose_from(time_us, coefficients, count, bands, Shown::kLive);
  if (!key) return web::failed(key.error());
  playout->playout.add_next(*std::move(key));
  return 0;
}

const core_shown* playout_at(core_playout* playout, int64_t now_us) {
  playout->pose = playout->playout.at(now_us);
  if (!playout->pose) return nullptr;
  const PlayoutPose& pose = *playout->pose;
  playout->shown = {pose.time_us,
                    pose.coefficients.begin(),
                    static_cast<std::uint32_t>(pose.coefficients.size()),
                    pose.bands.bits,
                    static_cast<std::uint8_t>(pose.shown),
                    static_cast<std::uint8_t>(pose.settling ? 1 : 0),
                    0};
  return &playout->shown;
}

int64_t playout_keep_lag(core_playout* playout, int64_t lag_us) {
  playout->playout.set_lag(lag_us == INT64_MIN ? std::nullopt : std::optional(bounded_time(lag_us)));
  return playout->playout.needed_lag_us().value_or(INT64_MIN);
}

int64_t playout_delay_us(const core_playout* playout) {
  return playout->playout.delay_us();
}

void playout_reset(core_playout* playout) {
  playout->playout.reset();
}
