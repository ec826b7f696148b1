// SPDX-License-Identifier: MIT
#include "broker/sockets/turn.h"

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

}  // namespace

struct Uring {
  io_uring ring{};
  bool open = false;
  /// One write of a batch: `count` pieces from pieces[first] on.
  struct Write {
    SocketWriter* writer;
    std::size_t first;
    std::size_t count;
  };
  std::vector<Write> writes;
  std::vector<iovec> pieces;
  std::vector<msghdr> messages;

  ~Uring() {
    if (open) io_uring_queue_exit(&ring);
  }

  void add(SocketWriter& writer) {
    std::array<iovec, SocketWriter::kMaxPieces> all;
    const std::size_t count = writer.pieces(all);
    if (count == 0) return;
    writes.push_back({&writer, pieces.size(), count});
    pieces.insert(pieces.end(), all.begin(), all.begin() + count);
  }

  void submit() {
    messages.resize(writes.size());
    for (std::size_t i = 0; i < writes.size(); ++i) {
      const Write& write = writes[i];
      io_uring_sqe* entry = io_uring_get_sqe(&ring);
      const int socket = write.writer->plain_socket();
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
      if (submitted < 0 && submitted != -EINTR && submitted != -EAGAIN && submitted != -EBUSY)
        break;  // Not observed in practice.
      std::array<io_uring_cqe*, 64> done;
      while (const unsigned count = io_uring_peek_batch_cqe(&ring, done.data(), done.size())) {
        for (unsigned i = 0; i < count; ++i) {
          const std::size_t which = io_uring_cqe_get_data64(done[i]);
          std::exchange(writes[which].writer, nullptr)
              ->written(Transport::outcome_of(done[i]->res, Transport::Wait::kWritable));
        }
        io_uring_cq_advance(&ring, count);
        outstanding -= count;
      }
    }
    for (const Write& write : writes) {  // Their outcome is unknown.
      if (write.writer != nullptr) write.writer->written({0, Transport::Wait::kNo, asio::error::connection_aborted});
    }
    writes.clear();
    pieces.clear();
  }
};

Result<std::shared_ptr<Uring>> open_uring() {
  io_uring_params params{};
  params.flags = IORING_SETUP_SINGLE_ISSUER | IORING_SETUP_COOP_TASKRUN | IORING_SETUP_CQSIZE;
  params.cq_entries = 4 * kBatch;
  auto opened = std::make_shared<Uring>();
  if (const int error = io_uring_queue_init_params(kBatch, &opened->ring, &params); error < 0) {
    return fail(ErrorCode::kUnsupported, "the kernel refuses it: " + std::generic_category().message(-error));
  }
  opened->open = true;
  opened->pieces.reserve(kBatch + SocketWriter::kMaxPieces);
  return opened;
}

void write_all(Uring& ring, std::span<SocketWriter* const> writers) {
  for (SocketWriter* writer : writers) {
    if (writer->plain_socket() < 0) {
      writer->flush();
      continue;
    }
    ring.add(*writer);
    if (ring.writes.size() == kBatch) ring.submit();
  }
  if (!ring.writes.empty()) ring.submit();
}

#else

struct Uring {};

Result<std::shared_ptr<Uring>> open_uring() {
  return fail(ErrorCode::kUnsupported, "this program was built without liburing");
}

void write_all(Uring&, std::span<SocketWriter* const>) {}

#endif

}  // namespace eigencast::broker
