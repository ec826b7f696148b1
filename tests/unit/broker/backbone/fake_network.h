// SPDX-License-Identifier: MIT
#pragma once

#include <deque>
#include <functional>
#include <map>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "broker/backbone/directory.h"
#include "broker/backbone/link.h"

namespace eigencast::broker::testing {

class FakeLink;

/// What all FakeLinks share: messages on their way, and the table. Nothing moves but in run().
class FakeNetwork {
 public:
  struct Row {
    std::optional<std::string> text;
    std::uint64_t revision = 0;
  };

  /// Delivers until nothing is on its way any more.
  void run() {
    for (int i = 0; i < 100'000 && !coming.empty(); ++i) {
      const auto work = std::move(coming.front());
      coming.pop_front();
      work();
    }
  }
  void later(std::function<void()> work) { coming.push_back(std::move(work)); }

  std::vector<FakeLink*> links;
  /// The servers come back with nothing; their links are connected again by the test.
  void lose_table() {
    table.clear();
    revision = 0;
    ++tables;
  }

  std::map<std::string, Row> table;
  int tables = 1;
  std::uint64_t revision = 0;
  bool table_answers = true;
  bool holds_answers = false;  ///< What the table answers waits in `held`.
  std::deque<std::function<void()>> held;
  int writes = 0;
  std::function<bool(const std::string& subject)> drops;
  std::map<std::string, int> asked;  ///< By subject.
  std::deque<std::function<void()>> coming;
};

/// A Link within one process.
class FakeLink final : public Link {
 public:
  explicit FakeLink(FakeNetwork& network) : network_(network) { network.links.push_back(this); }
  ~FakeLink() override { std::erase(network_.links, this); }

  void connect() {
    connected_ = true;
    network_.later([this] {
      listener_->on_connected();
      if (!network_.table_answers) return;
      if (std::exchange(table_, network_.tables) != network_.tables) listener_->on_new_table();
      for (const auto& [key, row] : network_.table) listener_->on_row(key, row.text, row.revision, {});
      listener_->on_table_read();
    });
  }
  void cut() {
    connected_ = false;
    network_.later([this] { listener_->on_disconnected("cut by the test"); });
  }

  void start(Listener& listener) override {
    listener_ = &listener;
    if (connected_) connect();
  }
  void stop() override {
    network_.run();  // What waits still leaves.
    connected_ = false;
    listener_ = nullptr;
  }
  using Link::publish;
  void publish(const std::string& subject, Bytes message, const std::string& /*holder*/) override {
    if (!connected_ || (network_.drops && network_.drops(subject))) return;
    network_.later([this, subject, message = std::move(message)] {
      for (FakeLink* link : network_.links) {
        if (!link->connected_) continue;
        for (const auto& heard : std::vector(link->heard_)) {
          if (matches(heard->subject, subject) && heard->handler) heard->handler(subject, message);
        }
      }
    });
  }
  std::shared_ptr<void> subscribe(const std::string& subject, Handler handler) override {
    return listen({subject, std::move(handler), {}});
  }
  std::shared_ptr<void> serve(const std::string& subject, OnRequest on_request) override {
    return listen({subject, {}, std::move(on_request)});
  }
  void ask(const std::string& subject, Bytes message, TimeUs, Answer answer) override {
    ++network_.asked[subject];
    network_.later([this, subject, message = std::move(message), answer = std::move(answer)] {
      for (FakeLink* link : network_.links) {
        if (!link->connected_ || !connected_) continue;
        for (const auto& heard : std::vector(link->heard_)) {
          if (heard->subject != subject || !heard->on_request) continue;
          heard->on_request(message, [this, answer](Bytes bytes) {
            network_.later([answer, bytes = std::move(bytes)] { answer(bytes); });
          });
          return;
        }
      }
      answer(fail(ErrorCode::kUnreachable, "nobody listens"));
    });
  }
  void write_row(const std::string& key, std::optional<std::string> text, std::uint64_t expected,
                 std::function<void(const Result<std::uint64_t>&)> written) override {
    network_.later([this, key, text = std::move(text), expected, written = std::move(written)] {
      if (!connected_ || !network_.table_answers) return written(fail(ErrorCode::kUnreachable, "no answer"));
      ++network_.writes;
      if (network_.table[key].revision != expected) return written(fail(ErrorCode::kRefused, "another revision"));
      const FakeNetwork::Row row = network_.table[key] = {text, ++network_.revision};
      if (!text) network_.table.erase(key);  // Purged.
      for (FakeLink* link : network_.links) {
        network_.later([link, key, row] {
          if (link->connected_ && link->listener_ != nullptr) link->listener_->on_row(key, row.text, row.revision, {});
        });
      }
      const auto acknowledge = [written, revision = row.revision] { written(revision); };
      network_.holds_answers ? network_.held.push_back(acknowledge) : acknowledge();
    });
  }
  void publish_row(const std::string& key, const std::optional<std::string>& text, std::uint64_t revision) override {
    const std::string from = text ? entry_from_text(*text).value().owner : std::string();
    for (FakeLink* link : network_.links) {
      if (link == this || !connected_) continue;
      network_.later([link, key, text, revision, from] {
        if (link->connected_ && link->listener_ != nullptr) link->listener_->on_row(key, text, revision, from);
      });
    }
  }

 private:
  struct Heard {
    std::string subject;
    Handler handler;
    OnRequest on_request;
  };
  static bool matches(const std::string& wanted, const std::string& subject) {
    return wanted == subject || (wanted.ends_with('>') && subject.starts_with(wanted.substr(0, wanted.size() - 1)));
  }
  std::shared_ptr<void> listen(Heard heard) {
    auto item = std::make_shared<Heard>(std::move(heard));
    heard_.push_back(item);
    return {item.get(), [this, item](void*) { std::erase(heard_, item); }};
  }

  FakeNetwork& network_;
  Listener* listener_ = nullptr;
  std::vector<std::shared_ptr<Heard>> heard_;
  bool connected_ = true;
  int table_ = 0;  ///< Indexes network_.tables.
};

}  // namespace eigencast::broker::testing
