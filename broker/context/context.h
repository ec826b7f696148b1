// SPDX-License-Identifier: MIT
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <map>
#include <set>
#include <string>
#include <vector>

#include "broker/config/config.h"
#include "broker/context/counters.h"
#include "common/core/log.h"

namespace boost::asio {
class io_context;
}  // namespace boost::asio

namespace eigencast::broker {

class AssetStore;
class Backbone;
class Connection;
class DiskThreads;
class FairReads;
class Gate;
struct History;
class Hub;
class Loops;
class Moments;
class LoopShare;
class Ownership;
class Recorder;
class Rooms;
class Turn;
class Upload;

/// What the event loops of a broker share; outlives them. Thread-safe unless said otherwise.
struct SharedContext {
  DiskThreads& disk;     ///< Runs calls that block on the disk.
  DiskThreads& commits;  ///< Makes uploads durable: reads never wait for that.
  DiskThreads& past;     ///< Reads the history: nothing else waits for that.
  Gate& gate;
  AssetStore& assets;
  Recorder& recorder;
  History& history;
  Ownership& ownership;      ///< Belongs to the first loop.
  const Backbone* backbone;  ///< Belongs to the first loop. Null: this broker has no cluster.
  LogSink log;
  std::string version;
  std::string session_id;
};

using Connections = std::map<std::uint64_t, Connection*>;  ///< By id.

/// What the connections of one event loop share. Built before them, destroyed after them. Used on the loop's thread.
struct Context : SharedContext {
  boost::asio::io_context& loop;  ///< Any thread may post to it.
  Config config;                  ///< As of the latest reload.
  Hub& hub;
  Turn& turn;            ///< Writes at the end of each turn of the loop.
  LoopShare& newcomers;  ///< Time for HTTP and TLS handshakes,
  LoopShare& viewers;    ///< and for what viewers ask for: crowds at many addresses have many budgets.
  Loops& loops;          ///< Belongs to the first loop, as senders, HTTP and the admin port do.
  std::atomic<std::uint64_t>& last_connection_id;  ///< All loops share it.
  FairReads& memory_reads;  ///< Memories of senders here and at other brokers. Of the first loop.
  FairReads& past_reads;    ///< The history, for viewers.
  Rooms& rooms;             ///< All loops share them,
  Moments& moments;         ///< and these.
  /// Connections of this loop, those on their way to it included. Any thread may read it.
  std::atomic<std::uint64_t> connection_count{0};
  Counters counters{};
  Connections connections{};         ///< Open WebSockets.
  Connections on_beat{};             ///< They are told news at most ten times a second,
  std::function<void()> arm_beat{};  ///< once this is called for the first.
  TimeUs started_us = 0;
  std::function<void()> drain{};  ///< Begins to stop, as SIGTERM does.
  bool draining = false;
  std::set<Upload*> uploads{};  ///< That hold a slot. Of the first loop.
  bool disk_fails = false;      ///< The data folder takes no files. Of the first loop.
  std::vector<std::uint8_t> read_buffer = std::vector<std::uint8_t>(64 * 1024);  ///< For the connection being read.
};

}  // namespace eigencast::broker
