// SPDX-License-Identifier: MIT
#include "broker/connections/uring.h"

#ifdef EIGENCAST_HAS_URING
#include <liburing.h>
#include <sys/socket.h>

#include <array>
#include <cerrno>
#include <utility>
#include <vector>
#endif

namespace eigencast::broker {

#ifdef EIGENCAST_HAS_URING

namespace {

constexpr unsigned kBatch = 1024;

Transport::Outcome outcome_of(int result) {
  if (result >= 0) return {static_cast<std::size_t>(result), Transport::Wait::kNo, {}};
  if (result == -EAGAIN || result == -EINTR) return {0, Transport::Wait::kWritable, {}};
  return {0, Transport::Wait::kNo, ErrorOf(-result, boost::system::system_category())};
}

}  // namespace

struct Uring::Ring {
  io_uring ring{};
  bool open = false;
  /// One write of a batch; where it has several pieces, they lie in `pieces` from `first` on.
  struct Write {
    Leaver* leaver;
    std::size_t first;
    std::size_t count;
  };
  std::vector<Write> writes;
  std::vector<iovec> pieces;
  std::vector<msghdr> messages;

  ~Ring() {
    if (open) io_uring_queue_exit(&ring);
  }

  void add(Leaver& leaver) {
    std::array<iovec, Leaver::kMaxPieces> all;
    const std::size_t count = leaver.pieces(all);
    if (count == 0) return;
    writes.push_back({&leaver, pieces.size(), count});
    pieces.insert(pieces.end(), all.begin(), all.begin() + count);
  }

  void submit() {
    messages.resize(writes.size());
    for (std::size_t i = 0; i < writes.size(); ++i) {
      const Write& write = writes[i];
      io_uring_sqe* entry = io_uring_get_sqe(&ring);
      const int socket = write.leaver->plain_socket();
      if (write.count == 1) {
        const iovec& piece = pieces[write.first];
        io_uring_prep_send(entry, socket, piece.iov_base, piece.iov_len, kSendFlags);
      } else {
        messages[i] = {};
        messages[i].msg_iov = pieces.data() + write.first;
        messages[i].msg_iovlen = write.count;
        io_uring_prep_sendmsg(entry, socket, &messages[i], kSendFlags);
      }
      io_uring_sqe_set_data64(entry, i);
    }
    collect();
  }

  void collect() {
    std::size_t outstanding = writes.size();
    while (outstanding > 0) {
      const int submitted = io_uring_submit_and_wait(&ring, static_cast<unsigned>(outstanding));
      if (submitted < 0 && submitted != -EINTR && submitted != -EAGAIN && submitted != -EBUSY) break;  // Never seen.
      std::array<io_uring_cqe*, 64> done;
      while (const unsigned count = io_uring_peek_batch_cqe(&ring, done.data(), done.size())) {
        for (unsigned i = 0; i < count; ++i) {
          const std::size_t which = io_uring_cqe_get_data64(done[i]);
          const int result = done[i]->res;
          std::exchange(writes[which].leaver, nullptr)->left(outcome_of(result));
        }
        io_uring_cq_advance(&ring, count);
        outstanding -= count;
      }
    }
    for (const Write& write : writes) {  // What the kernel did of these nobody knows.
      if (write.leaver != nullptr) write.leaver->left({0, Transport::Wait::kNo, asio::error::connection_aborted});
    }
    writes.clear();
    pieces.clear();
  }
};

Uring::Uring(std::unique_ptr<Ring> ring) : ring_(std::move(ring)) {}
Uring::~Uring() = default;

Result<std::unique_ptr<Uring>> Uring::open() {
  io_uring_params params{};
  params.flags = IORING_SETUP_SINGLE_ISSUER | IORING_SETUP_COOP_TASKRUN | IORING_SETUP_CQSIZE;
  params.cq_entries = 4 * kBatch;
  auto ring = std::make_unique<Ring>();
  if (const int error = io_uring_queue_init_params(kBatch, &ring->ring, &params); error < 0) {
    return fail(ErrorCode::kUnsupported, "the kernel refuses it: " + std::generic_category().message(-error));
  }
  ring->open = true;
  ring->pieces.reserve(kBatch + Leaver::kMaxPieces);
  return std::unique_ptr<Uring>(new Uring(std::move(ring)));
}

void Uring::write(std::span<Leaver* const> leavers) {
  for (Leaver* leaver : leavers) {
    if (leaver->plain_socket() < 0) {
      leaver->leave();
      continue;
    }
    ring_->add(*leaver);
    if (ring_->writes.size() == kBatch) ring_->submit();
  }
  if (!ring_->writes.empty()) ring_->submit();
}

#else

struct Uring::Ring {};
Uring::Uring(std::unique_ptr<Ring> ring) : ring_(std::move(ring)) {}
Uring::~Uring() = default;

Result<std::unique_ptr<Uring>> Uring::open() {
  return fail(ErrorCode::kUnsupported, "this program was built without liburing");
}

void Uring::write(std::span<Leaver* const> leavers) {
  for (Leaver* leaver : leavers) leaver->leave();
}

#endif

}  // namespace eigencast::broker
