// SPDX-License-Identifier: MIT
#include "broker/operation/metrics.h"

#include <prometheus/metric_family.h>
#include <prometheus/text_serializer.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <bit>
#include <fstream>
#include <functional>
#include <limits>
#include <numeric>
#include <utility>

#include "broker/access/gate.h"
#include "broker/backbone/backbone.h"
#include "broker/relay/hub.h"
#include "broker/relay/rooms.h"
#include "broker/storage/asset_store.h"
#include "broker/storage/history.h"
#include "broker/storage/recorder.h"
#include "common/wire/link_bytes.h"

namespace eigencast::broker {
namespace {

using prometheus::ClientMetric;
using prometheus::MetricFamily;
using prometheus::MetricType;
using Labels = std::vector<ClientMetric::Label>;

void add_to(EventCounts& sum, const EventCounts& other) {
  using Numbers = std::array<std::uint64_t, sizeof(EventCounts) / sizeof(std::uint64_t)>;
  auto total = std::bit_cast<Numbers>(sum);
  const auto more = std::bit_cast<Numbers>(other);
  std::transform(total.begin(), total.end(), more.begin(), total.begin(), std::plus());
  sum = std::bit_cast<EventCounts>(total);
}

/// Plain integer counters become metrics only on request.
class BrokerMetrics {
 public:
  BrokerMetrics(const Context& context, const Statistics& statistics) : context_(context), statistics_(statistics) {
    connections();
    streams();
    frames();
    storage();
    recordings();
    backbone();
    process();
  }

  const std::vector<MetricFamily>& families() const { return families_; }

 private:
  MetricFamily& family(const std::string& name, MetricType type, const char* help) {
    families_.push_back({name, help, type, {}});
    return families_.back();
  }
  static void add(MetricFamily& family, double value, Labels labels = {}) {
    ClientMetric metric;
    metric.label = std::move(labels);
    metric.counter.value = metric.gauge.value = value;
    family.metric.push_back(std::move(metric));
  }
  template <typename Number>
  void gauge(const char* name, const char* help, Number value) {
    add(family(std::string("eigencast_broker_") + name, MetricType::Gauge, help), static_cast<double>(value));
  }
  void counter(const char* name, const char* help, std::uint64_t value) {
    add(family(std::string("eigencast_broker_") + name, MetricType::Counter, help), static_cast<double>(value));
  }
  void histogram(const char* name, const char* help, const LatencyBuckets& from) {
    ClientMetric metric;
    std::uint64_t count = 0;
    for (std::size_t i = 0; i < from.counts.size(); ++i) {
      count += from.counts[i];
      const double bound = i < LatencyBuckets::kUpTo.size() ? static_cast<double>(LatencyBuckets::kUpTo[i]) / 1e6
                                                            : std::numeric_limits<double>::infinity();
      metric.histogram.bucket.push_back({count, bound});
    }
    metric.histogram.sample_count = count;
    metric.histogram.sample_sum = static_cast<double>(from.sum_us) * 1e-6;
    family(std::string("eigencast_broker_") + name, MetricType::Histogram, help).metric.push_back(std::move(metric));
  }

  void connections() {
    const Counters& counters = statistics_.counters;
    add(family("eigencast_broker_build_info", MetricType::Gauge, "Always 1; the version is a label."), 1,
        {{"version", context_.version}});
    gauge("draining", "1 while the broker stops.", context_.draining);
    gauge("connections", "Open connections of the data port.", statistics_.connections_total());
    gauge("connections_max", "limits.max_connections, or fewer, where the process may have fewer descriptors.",
          context_.gate.policy()->max_connections());
    auto& of_loops = family("eigencast_broker_loop_connections", MetricType::Gauge,
                            "Those of each event loop; the first, 0, has all that are not viewers.");
    for (std::size_t i = 0; i < statistics_.connections.size(); ++i) {
      add(of_loops, static_cast<double>(statistics_.connections[i]), {{"loop", std::to_string(i)}});
    }
    counter("connections_total", "Connections accepted on the data port.", counters.connections_total);
    counter("connections_refused_total", "Connections over limits.max_connections.", counters.connections_refused);
    counter("requests_denied_total", "Requests turned away for want of rights, or over a limit.",
            context_.gate.denied());
    counter("slow_disconnects_total", "Connections closed because control messages piled up.",
            counters.slow_disconnects);
    counter("kicked_total", "Connections closed through the admin API.", counters.kicked);
    counter("reloads_total", "Configurations taken by a reload.", counters.reloads);
    counter("reloads_failed_total", "Reloads that changed nothing, for an error.", counters.reloads_failed);
    counter("control_received_total", "Control messages received.", counters.control_received);
    counter("control_sent_total", "Control messages sent.", counters.control_sent);
  }

  void streams() {
    std::uint64_t states[3] = {0, 0, 0};
    std::uint64_t watchers = 0;
    for (const Stream* stream : context_.hub.streams()) {
      ++states[static_cast<std::size_t>(stream->state())];
      watchers += stream->watchers();
    }
    auto& known = family("eigencast_broker_streams", MetricType::Gauge, "Streams known, by state.");
    for (std::size_t i = 0; i < 3; ++i) {
      const auto state = static_cast<control::StreamInfo::State>(i);
      add(known, static_cast<double>(states[i]), {{"state", std::string(name_of(state))}});
    }
    gauge("subscriptions", "Streams watched, summed over connections.", watchers);
    gauge("poses_failed", "Poses left out, summed over the streams known: beyond the codec's range or work_us_per_s.",
          statistics_.poses_failed);
    counter("senders_replaced_total", "Senders that another one took the place of.",
            statistics_.counters.senders_replaced);
  }

  void frames() {
    const Counters& counters = statistics_.counters;
    counter("frames_received_total", "Frames taken from senders.", counters.frames_received);
    counter("frames_refused_total", "Frames of senders that broke the protocol.", counters.frames_refused);
    gauge("rooms", "Rooms with somebody in them.", context_.rooms.size());
    gauge("room_members", "People in rooms.", context_.rooms.members());
    gauge("room_bytes", "What is said in rooms, as rooms.max_bytes counts it.", context_.rooms.bytes());
    gauge("memory_bytes", "Poses that streams remember.", context_.hub.memory_bytes());
    counter("memories_total", "Memories taken from senders, appended ones included.", counters.memories);
    counter("memories_refused_total", "Memories refused.", counters.memories_refused);
    counter("keys_recalled_total", "Frames taken that a memory predicts.", counters.keys_recalled);
    auto& received = family("eigencast_broker_frame_bytes_received_total", MetricType::Counter,
                            "Bytes of frames taken from senders, by what predicts them: a key's mean with a memory and "
                            "without tells what memories save.");
    const std::uint64_t recalled = counters.recalled_bytes;
    add(received, static_cast<double>(counters.frame_bytes_received - recalled), {{"predicted_from", "keys"}});
    add(received, static_cast<double>(recalled), {{"predicted_from", "memory"}});
    counter("frames_sent_total", "Frames sent to viewers.", counters.frames_sent);
    counter("frame_bytes_sent_total", "Bytes of those frames.", counters.frame_bytes_sent);
    auto& link = family("eigencast_broker_frame_link_bytes", MetricType::Gauge,
                        "What a frame sent, of their mean size, takes on a link beyond itself (LinkBytes).");
    const auto sent = static_cast<double>(counters.frames_sent);
    const LinkBytes more =
        sent > 0 ? link_bytes(1, static_cast<double>(counters.frame_bytes_sent) / sent) : LinkBytes{};
    add(link, more.websocket, {{"layer", "websocket"}});
    add(link, more.tcp_ip, {{"layer", "tcp_ip"}});
    add(link, more.tls, {{"layer", "tls"}});
    counter("frames_dropped_total", "Frames replaced by newer ones before they left.", counters.frames_dropped);
    counter("joins_sent_total", "Join frames sent: viewers that came, or had missed something.", counters.joins_sent);
    auto& steps = family("eigencast_broker_ladder_steps_total", MetricType::Counter,
                         "Profiles changed for links that take less or more, by where the step led.");
    for (const char* rung : {"asked", "linear", "raw", "fewer-bands"}) {
      for (const auto& [direction, taken] :
           {std::pair("down", &counters.ladder_down), std::pair("up", &counters.ladder_up)}) {
        const auto found = taken->find(rung);
        add(steps, found == taken->end() ? 0 : static_cast<double>(found->second),
            {{"direction", direction}, {"rung", rung}});
      }
    }
    histogram("frame_delay_seconds", "From when a pose was to leave (a raw key: had come) to its first write.",
              counters.latency);
    histogram("key_hold_seconds", "From a key's coming to when interpolation let it go.", counters.hold);
  }

  void storage() {
    const Counters& counters = statistics_.counters;
    gauge("disk_failing", "1 while the data folder takes no files.", context_.disk_fails);
    gauge("asset_bytes", "What the asset store takes of its quota, uploads under way included.",
          context_.assets.total_bytes());
    gauge("asset_quota_bytes", "assets.max_total_bytes.", context_.assets.settings().max_total_bytes);
    gauge("asset_objects", "Objects in the asset store, uploads under way included.", context_.assets.objects());
    counter("assets_evicted_total", "Objects removed to make room.", context_.assets.evicted());
    gauge("uploads", "Uploads under way.", counters.uploads_now);
    counter("uploads_total", "Assets taken.", counters.uploads);
    counter("uploads_failed_total", "Uploads refused or cut off.", counters.uploads_failed);
    counter("upload_bytes_total", "Bytes of uploads received.", counters.upload_bytes);
    gauge("downloads", "Downloads under way.", counters.downloads_now);
    counter("downloads_total", "Assets served, whole or in part.", counters.downloads);
    counter("download_bytes_total", "Bytes of assets sent.", counters.download_bytes);
  }

  void recordings() {
    const Recorder::Totals totals = context_.recorder.totals();
    gauge("recordings_active", "Streams being recorded, or waited for.", totals.active);
    counter("recordings_failed_total", "Recordings that the disk ended.", totals.failed);
    counter("recorded_frames_total", "Frames recorded.", totals.frames);
    counter("recorded_bytes_total", "Bytes written into recordings.", totals.bytes);
    counter("recording_frames_dropped_total", "Frames left out because the disk was behind.", totals.dropped);
    gauge("recording_queue_bytes", "Waiting for the disk.", totals.queued_bytes);
    gauge("recording_stored_bytes", "All recordings on the disk.", totals.stored_bytes);
    const History& history = context_.history;
    const Recorder::Totals kept = history.kept ? history.kept->totals() : Recorder::Totals{};
    counter("history_failed_total", "How often the disk failed what is kept of a stream; it is tried again.",
            kept.failed);
    counter("history_frames_dropped_total", "Frames left out because the disk was behind.", kept.dropped);
    gauge("history_stored_bytes", "All that is kept of streams.", kept.stored_bytes);
    gauge("history_viewers", "Viewers that see the past.", history.viewers.used());
  }

  void backbone() {
    const Backbone::Totals totals = context_.backbone == nullptr ? Backbone::Totals{} : context_.backbone->totals();
    gauge("backbone_configured", "1 where backbone.servers names servers.", context_.backbone != nullptr);
    gauge("backbone_connected", "1 while there is a connection to NATS.", totals.connected);
    gauge("backbone_brokers", "Brokers heard of, this one included.", totals.brokers);
    gauge("backbone_streams_known", "Streams that have a sender at any of the brokers.", totals.streams_known);
    gauge("backbone_streams_subscribed", "Streams of other brokers, watched here.", totals.streams_subscribed);
    counter("backbone_frames_published_total", "Keys of senders here, sent to other brokers.", totals.frames_published);
    counter("backbone_frames_followed_total", "Keys of senders at other brokers.", totals.frames_followed);
    counter("backbone_frames_dropped_total", "Messages of other brokers that were of no use, or too many.",
            totals.frames_dropped);
    counter("backbone_joins_asked_total", "Joins asked of other brokers: beginnings and gaps.", totals.joins_asked);
    counter("backbone_joins_answered_total", "Joins given to other brokers.", totals.joins_answered);
    counter("backbone_claims_refused_total", "Senders refused because another broker has one.", totals.claims_refused);
    counter("backbone_senders_evicted_total", "Senders sent away because another broker has a later one.",
            totals.senders_evicted);
    counter("backbone_disconnects_total", "Losses of the connection to NATS.", totals.disconnects);
    counter("backbone_asset_bytes_total", "Bytes of assets copied from other brokers.", totals.asset_bytes_fetched);
  }

  void process() {
    rusage used{};
    getrusage(RUSAGE_SELF, &used);
    const auto seconds = [](const timeval& time) {
      return static_cast<double>(time.tv_sec) + static_cast<double>(time.tv_usec) * 1e-6;
    };
    add(family("process_cpu_seconds_total", MetricType::Counter, "CPU time, user and system."),
        seconds(used.ru_utime) + seconds(used.ru_stime));
    double pages = 0, resident = 0;
    std::ifstream("/proc/self/statm") >> pages >> resident;
    const auto page = static_cast<double>(::sysconf(_SC_PAGESIZE));
    add(family("process_resident_memory_bytes", MetricType::Gauge, "Memory in use."), resident * page);
    add(family("process_virtual_memory_bytes", MetricType::Gauge, "Address space in use."), pages * page);
    gauge("uptime_seconds", "Since the broker started.",
          static_cast<double>(steady_now_us() - context_.started_us) * 1e-6);
  }

  const Context& context_;
  const Statistics& statistics_;
  std::vector<MetricFamily> families_;
};

}  // namespace

void Statistics::add(const Context& loop) {
  add_to(counters, loop.counters);
  for (const auto& [rung, steps] : loop.counters.ladder_down) counters.ladder_down[rung] += steps;
  for (const auto& [rung, steps] : loop.counters.ladder_up) counters.ladder_up[rung] += steps;
  counters.latency += loop.counters.latency;
  counters.hold += loop.counters.hold;
  connections.push_back(loop.connection_count);
  for (const Stream* stream : loop.hub.streams()) poses_failed += stream->poses_failed();
}

std::uint64_t Statistics::connections_total() const {
  return std::accumulate(connections.begin(), connections.end(), std::uint64_t{0});
}

std::string metrics_text(const Context& context, const Statistics& statistics) {
  return prometheus::TextSerializer().Serialize(BrokerMetrics(context, statistics).families());
}

}  // namespace eigencast::broker
