// SPDX-License-Identifier: MIT
#include <poll.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <nlohmann/json.hpp>

#include "sender/commands.h"
#include "sender/growing_bake.h"
#include "sender/live.h"
#include "sender/order_check.h"
#include "sender/pose_stream.h"

namespace eigencast {
namespace {

constexpr int kPollMs = 50;
constexpr TimeUs kFirstConnectionUs = 5'000'000;

/// 0 at the end of the stream, nothing if interrupted.
Result<std::optional<std::size_t>> read_some(std::span<char> room, Interrupt& interrupt) {
  while (!interrupt.requested()) {
    pollfd input{STDIN_FILENO, POLLIN, 0};
    if (::poll(&input, 1, kPollMs) <= 0) continue;
    const ssize_t got = ::read(STDIN_FILENO, room.data(), room.size());
    if (got >= 0) return std::optional<std::size_t>(static_cast<std::size_t>(got));
    if (errno != EINTR && errno != EAGAIN)
      return fail(ErrorCode::kIo, std::string("standard input: ") + std::strerror(errno));
  }
  return std::optional<std::size_t>();
}

struct Counts {
  std::uint64_t poses = 0, unusable = 0, misfits = 0;
  std::size_t unfinished_bytes = 0;
  std::uint64_t restarts = 0;
};

Result<void> pump(const PipeCommand& command, const Surface& mesh, Publisher& publisher, Counts& counts,
                  Interrupt& interrupt) {
  const std::size_t vertices = mesh.vertex_count();
  PoseStream stream(vertices);
  ArrivalCheck order(mesh, command.source.any_order);
  PipePace pace(command.rate_hz);
  StatusLog status(steady_now_us());
  while (true) {
    const auto got = read_some(stream.room(), interrupt);
    if (!got) return got.error();
    if (!*got) return {};
    if (**got == 0) break;
    const auto whole = stream.filled(**got);
    if (!whole) return whole.error();
    if (!*whole) continue;
    const auto misfit = order.check(stream.positions(), stream.count() - 1, steady_now_us());
    if (!misfit) return misfit.error();
    if (*misfit) spdlog::warn("{}", **misfit);
    counts.misfits = order.misfits();
    const auto due_us = pace.due_us(steady_now_us(), stream.time_s());
    if (!due_us) return due_us.error();
    if (interrupt.wait_until(*due_us)) return {};
    if (const auto ours = check_ownership(publisher); !ours) return ours;
    const auto sent = publisher.send_positions(stream.positions(), *due_us);
    // One pose that a simulation spoilt must not end the show.
    if (!sent && counts.unusable++ == 0)
      spdlog::warn("pose {} is left out: {}", stream.count() - 1, sent.error().message);
    counts.poses = stream.count();
    counts.restarts = pace.restarts();
    status.show(publisher, steady_now_us());
  }
  counts.unfinished_bytes = stream.unfinished_bytes();
  if (counts.unfinished_bytes > 0) {
    spdlog::warn("the stream ended within pose {}: {} bytes of {}; has the mesh as many vertices as the poses?",
                 stream.count(), counts.unfinished_bytes, vertices * 3 * sizeof(float));
  }
  return {};
}

/// On the bake's thread.
void take_whole(const PipeCommand& command, Publisher& publisher, Result<BakeResult>& whole) {
  if (!whole) return stay_coarse(whole.error());
  auto asset = std::make_shared<const Asset>(std::move(whole->asset));
  auto encoded = std::make_shared<const EncodedAsset>(std::move(whole->encoded));
  go_over(publisher, *whole, std::move(asset), std::move(encoded));
  publisher.learn(command.target.learn);
}

}  // namespace

int run(const PipeCommand& command, const Console& console, Interrupt& interrupt) {
  if (::isatty(STDIN_FILENO) == 1) {
    spdlog::error(
        "standard input is a terminal: send the poses into it, simulation | eigencast-sender pipe ..., or < poses");
    return kExitUsage;
  }
  if (const ExitCode usable = check_target(command.target); usable != kExitOk) return usable;
  std::unique_ptr<Publisher> publisher;
  GrowingBake bake(command.source, {});  // Ends first.
  auto baked = bake.first(console, interrupt);
  if (!baked) return report_failure(baked.error());
  const auto begun = store(publisher, publish(command.target, command.rate_hz > 0 ? command.rate_hz : 30,
                                              std::make_shared<const Asset>(std::move(baked->asset)),
                                              std::make_shared<const EncodedAsset>(std::move(baked->encoded))));
  if (!begun) return report_failure(begun.error());
  if (bake.is_whole()) {
    publisher->learn(command.target.learn);
  } else {
    bake.then([&](Result<BakeResult>& whole) { take_whole(command, *publisher, whole); },
              [&](double fraction) { publisher->show_progress(fraction); });
  }
  // Long enough to play a file whole, short enough that a simulation does not wait for an absent broker.
  if (!wait_until_live(*publisher, steady_now_us() + kFirstConnectionUs, interrupt) && !interrupt.requested()) {
    spdlog::warn("the broker is not there yet; poses are dropped until it is: {}", publisher->stats().detail);
  }
  Counts counts;
  const auto pumped = pump(command, bake.clip().rest(), *publisher, counts, interrupt);
  const Publisher::Stats stats = publisher->stats();
  spdlog::info("read {} poses, sent {}, dropped {}", counts.poses, stats.frames_sent, stats.frames_dropped);
  const nlohmann::json report{{"poses", counts.poses},
                              {"frames_sent", stats.frames_sent},
                              {"frames_dropped", stats.frames_dropped},
                              {"unusable", counts.unusable},
                              {"misfits", counts.misfits},
                              {"unfinished_bytes", counts.unfinished_bytes},
                              {"restarts", counts.restarts},
                              {"bytes", stats.payload_bytes},
                              {"reconnects", stats.reconnects},
                              {"frames_recalled", stats.frames_recalled},
                              {"memory_bytes", stats.memory_bytes},
                              {"saved_bytes", stats.saved_bytes},
                              {"changes", stats.changes},
                              {"learnt_columns", stats.learnt_columns},
                              {"learnt_bytes", stats.learnt_bytes}};
  const auto written = write_report(command.json, report.dump(2));
  if (!pumped) return report_failure(pumped.error());
  if (!written) return report_failure(written.error());
  if (stats.frames_sent > 0) return kExitOk;
  const bool unreachable = counts.poses > counts.unusable;
  if (!unreachable) spdlog::error("nothing was sent: standard input brought no pose that can be shown");
  return unreachable ? kExitUnreachable : kExitFailed;
}

}  // namespace eigencast
