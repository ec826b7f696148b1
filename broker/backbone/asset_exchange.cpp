// SPDX-License-Identifier: MIT
#include "broker/backbone/asset_exchange.h"

#include <unistd.h>

#include <algorithm>
#include <utility>

#include "broker/backbone/directory.h"

namespace eigencast::broker {
namespace {

constexpr std::uint8_t kHere = 0, kNotHere = 1;

Bytes references_answer(const AssetStore& store, const Sha256& id) {
  const auto references = store.references_of(id);
  if (!references || references->size() > AssetExchange::kMaxReferences) return {kNotHere};
  Bytes bytes{kHere};
  ByteWriter out(bytes);
  for (const Sha256& reference : *references) out.bytes(reference.digest);
  return bytes;
}

Bytes range_answer(const AssetStore& store, const Sha256& id, std::uint64_t offset) {
  const auto object = store.read(id);
  if (!object || offset > object->size) return {kNotHere};
  const auto size =
      static_cast<std::size_t>(std::min<std::uint64_t>(AssetExchange::kRangeBytes, object->size - offset));
  Bytes bytes{kHere};
  ByteWriter(bytes).u64(object->size);
  const std::size_t head = bytes.size();
  bytes.resize(head + size);
  for (std::size_t read = 0; read < size;) {
    const ssize_t n =
        ::pread(object->file.get(), bytes.data() + head + read, size - read, static_cast<off_t>(offset + read));
    if (n <= 0) return {kNotHere};
    read += static_cast<std::size_t>(n);
  }
  return bytes;
}

Bytes answer(const AssetStore& store, ByteView request) {
  ByteReader in(request);
  const char what = static_cast<char>(in.u8());
  const ByteView digest = in.bytes(sizeof(Sha256::digest));
  if (in.failed()) return {kNotHere};
  Sha256 id;
  std::copy(digest.begin(), digest.end(), id.digest.begin());
  if (what == 'L' && in.finished()) return references_answer(store, id);
  const std::uint64_t offset = in.u64();
  return what == 'R' && in.finished() ? range_answer(store, id, offset) : Bytes{kNotHere};
}

Error malformed_reply() {
  return fail(ErrorCode::kCorrupt,
              "another broker answered with bytes that make no sense; do all of them run the same version?");
}

}  // namespace

struct AssetExchange::Transfer {
  std::string owner, payer;
  Sha256 asset;
  TimeUs began_us = 0;
  bool references_known = false;
  std::vector<Sha256> wanted;  ///< Not begun.
  std::size_t running = 0;
  bool over = false;
  std::vector<Done> done;
};

AssetExchange::AssetExchange(Link& link, AssetStore& store, std::string prefix, std::function<void(Work)> on_disk,
                             std::function<void(Work)> on_loop)
    : link_(link),
      store_(store),
      prefix_(std::move(prefix)),
      on_disk_(std::move(on_disk)),
      on_loop_(std::move(on_loop)) {}

void AssetExchange::stop() {
  *alive_ = false;
  serving_.reset();
  transfers_.clear();
}

void AssetExchange::serve(const std::string& self) {
  serving_ = link_.serve(prefix_ + ".assets." + self, [this](Bytes message, Link::Reply reply) {
    if (answering_ == kMaxAnswers) return reply({kNotHere});
    ++answering_;
    on_disk_([this, alive = alive_, on_loop = on_loop_, message = std::move(message), reply = std::move(reply)] {
      reply(answer(store_, message));
      on_loop([this, alive] {
        if (*alive) --answering_;
      });
    });
  });
}

void AssetExchange::fetch(const std::string& owner, const Sha256& asset, const std::string& payer, TimeUs now_us,
                          Done done) {
  if (const auto under_way = transfers_.find({owner, asset}); under_way != transfers_.end()) {
    under_way->second->done.push_back(std::move(done));
    return;
  }
  const auto is_of_name = [name = name_of_broker(owner)](const auto& item) {
    return name_of_broker(item.first.first) == name;
  };
  if (transfers_.size() >= kMaxTransfers ||
      std::count_if(transfers_.begin(), transfers_.end(), is_of_name) >= kMaxOfName)
    return done(fail(ErrorCode::kRefused, "too many assets of other brokers are on their way"));
  auto transfer = std::make_shared<Transfer>();
  transfer->owner = owner;
  transfer->payer = payer;
  transfer->asset = asset;
  transfer->began_us = now_us;
  const auto whole = whole_.find({owner, asset});
  transfer->references_known = whole != whole_.end() && now_us - whole->second < kWholeUs;
  if (whole != whole_.end() && !transfer->references_known) whole_.erase(whole);
  transfer->done.push_back(std::move(done));
  transfers_[{owner, asset}] = transfer;
  transfer->wanted = {asset};
  advance(transfer);
}

void AssetExchange::advance(const TransferPtr& transfer) {
  while (!transfer->over && transfer->running < kParallel && !transfer->wanted.empty()) {
    const Sha256 id = transfer->wanted.back();
    transfer->wanted.pop_back();
    if (store_.contains(id)) continue;
    ++transfer->running;
    begin_object(transfer, id);
  }
  if (transfer->over || transfer->running > 0 || !transfer->wanted.empty()) return;
  if (transfer->references_known) return finish(transfer, {});
  ++transfer->running;
  ask_references(transfer);
}

void AssetExchange::ask(const TransferPtr& transfer, char what, const Sha256& id, std::optional<std::uint64_t> offset,
                        std::function<void(Bytes)> answered) {
  Bytes request;
  ByteWriter out(request);
  out.u8(static_cast<std::uint8_t>(what));
  out.bytes(id.digest);
  if (offset) out.u64(*offset);
  const auto take = [this, transfer, id, alive = alive_, answered = std::move(answered)](Result<Bytes> answer) {
    if (!*alive || transfer->over) return;
    if (!answer) return finish(transfer, answer.error());
    if (answer->empty()) return finish(transfer, malformed_reply());
    if (answer->front() != kHere) {
      return finish(transfer, fail(ErrorCode::kNotFound,
                                   "object " + id.hex() + " is not at the broker that has the stream's sender"));
    }
    answered(std::move(*answer));
  };
  link_.ask(prefix_ + ".assets." + transfer->owner, std::move(request), kTimeoutUs, take);
}

void AssetExchange::ask_references(const TransferPtr& transfer) {
  ask(transfer, 'L', transfer->asset, std::nullopt, [this, transfer](Bytes answer) {
    --transfer->running;
    transfer->references_known = true;
    ByteReader in(answer);
    in.u8();
    if (in.remaining() % sizeof(Sha256::digest) != 0 || in.remaining() / sizeof(Sha256::digest) > kMaxReferences) {
      return finish(transfer, malformed_reply());
    }
    while (in.remaining() > 0) {
      const ByteView digest = in.bytes(sizeof(Sha256::digest));
      std::copy(digest.begin(), digest.end(), transfer->wanted.emplace_back().digest.begin());
    }
    advance(transfer);
  });
}

void AssetExchange::begin_object(const TransferPtr& transfer, const Sha256& id) {
  const auto upload = std::make_shared<UploadPtr>();
  const auto begin = [this, id, upload, payer = transfer->payer]() -> Result<void> {
    auto begun = store_.begin_upload(id, payer);
    if (begun) *upload = std::move(*begun);
    return begun ? Result<void>() : begun.error();
  };
  on_disk(transfer, begin, [this, transfer, id, upload] { ask_range(transfer, id, *upload, 0); });
}

void AssetExchange::ask_range(const TransferPtr& transfer, const Sha256& id, const UploadPtr& upload,
                              std::uint64_t offset) {
  ask(transfer, 'R', id, offset, [this, transfer, id, upload, offset](Bytes answer) {
    ByteReader in(answer);
    in.u8();
    const std::uint64_t size = in.u64();
    const std::uint64_t came = in.remaining();
    const bool makes_sense = !in.failed() && size <= store_.settings().max_object_bytes && offset <= size &&
                             came == std::min<std::uint64_t>(kRangeBytes, size - offset);
    if (!makes_sense) return finish(transfer, malformed_reply());
    fetched_bytes_ += came;
    const std::uint64_t next = offset + came;
    const auto write = [upload, answer = std::move(answer), came, whole = next == size]() -> Result<void> {
      const auto written = upload->write(ByteView(answer).last(came));
      if (!written || !whole) return written;
      const auto committed = upload->commit();
      return committed ? Result<void>() : committed.error();
    };
    on_disk(transfer, write, [this, transfer, id, upload, next, size] {
      if (next < size) return ask_range(transfer, id, upload, next);
      --transfer->running;
      advance(transfer);
    });
  });
}

void AssetExchange::on_disk(const TransferPtr& transfer, std::function<Result<void>()> work, Work then) {
  on_disk_([this, transfer, alive = alive_, work = std::move(work), then = std::move(then), on_loop = on_loop_] {
    on_loop([this, transfer, alive, result = work(), then] {
      if (!*alive || transfer->over) return;
      if (!result) return finish(transfer, result.error());
      then();
    });
  });
}

void AssetExchange::finish(const TransferPtr& transfer, const Result<void>& result) {
  transfer->over = true;
  transfers_.erase({transfer->owner, transfer->asset});
  if (whole_.size() >= kMaxWhole) whole_.clear();
  if (result) whole_.try_emplace({transfer->owner, transfer->asset}, transfer->began_us);
  for (const Done& done : transfer->done) done(result);
}

}  // namespace eigencast::broker
