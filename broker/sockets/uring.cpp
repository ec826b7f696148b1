// SPDX-License-Identifier: MIT
#include "broker/sockets/turn.h"

#ifdef EIGENCAST_HAS_URING
#include <liburing.h>
#include <sys/socket.h>

#include <cerrno>
#include <cstdint>
#include <system_error>
#include <vector>
#endif

namespace eigencast::broker {

#ifdef EIGENCAST_HAS_URING

namespace {

// Beside the writer in an entry's user data: of add_send(), else of add_pieces().
constexpr std::uint64_t kSend = 1;

// The kernel never puts a write with kSendFlags off: all are done when the call that hands them over returns. With
// MSG_WAITALL a partial write is a failure, which is reported even where success is not.
constexpr int kWholeFlags = kSendFlags | MSG_WAITALL;

}  // namespace

struct Uring {
  io_uring ring{};
  bool open = false;
  // What the entries of add_pieces() point to: of fixed size, so that it does not move.
  std::vector<iovec> pieces = std::vector<iovec>(kMaxBatch + SocketWriter::kMaxPieces);
  std::vector<msghdr> messages = std::vector<msghdr>(kMaxBatch);
  std::size_t used_pieces = 0, used_messages = 0;

  ~Uring() {
    if (open) io_uring_queue_exit(&ring);
  }
};

Result<std::shared_ptr<Uring>> open_uring() {
  io_uring_params params{};
  params.flags = IORING_SETUP_SINGLE_ISSUER | IORING_SETUP_COOP_TASKRUN | IORING_SETUP_CQSIZE;
  params.cq_entries = 4 * kMaxBatch;
  auto opened = std::make_shared<Uring>();
  if (const int error = io_uring_queue_init_params(kMaxBatch, &opened->ring, &params); error < 0) {
    return fail(ErrorCode::kUnsupported, "the kernel refuses it: " + std::generic_category().message(-error));
  }
  opened->open = true;
  return opened;
}

void add_send(Uring& uring, SocketWriter& writer, int socket, ByteView bytes, bool tell) {
  // As io_uring_get_sqe() and io_uring_prep_send(), less what holds of every entry of this ring: there is one free, and
  // no other field of it was ever set.
  io_uring_sq& queue = uring.ring.sq;
  io_uring_sqe& entry = queue.sqes[queue.sqe_tail++ & queue.ring_mask];
  entry.opcode = IORING_OP_SEND;
  entry.flags = tell ? 0 : IOSQE_CQE_SKIP_SUCCESS;
  entry.fd = socket;
  entry.addr = reinterpret_cast<std::uintptr_t>(bytes.data());
  entry.len = static_cast<std::uint32_t>(bytes.size());
  entry.msg_flags = kWholeFlags;
  entry.user_data = reinterpret_cast<std::uintptr_t>(&writer) | kSend;
}

bool add_pieces(Uring& uring, SocketWriter& writer, int socket) {
  iovec* pieces = &uring.pieces[uring.used_pieces];
  const std::size_t count = writer.pieces({pieces, SocketWriter::kMaxPieces});
  if (count == 0) return false;
  uring.used_pieces += count;
  io_uring_sqe* entry = io_uring_get_sqe(&uring.ring);
  if (count == 1) {
    io_uring_prep_send(entry, socket, pieces->iov_base, pieces->iov_len, kSendFlags);
  } else {
    msghdr& message = uring.messages[uring.used_messages++] = {};
    message.msg_iov = pieces;
    message.msg_iovlen = count;
    io_uring_prep_sendmsg(entry, socket, &message, kSendFlags);
  }
  io_uring_sqe_set_data64(entry, reinterpret_cast<std::uintptr_t>(&writer));
  return true;
}

bool has_room(const Uring& uring) {
  return uring.pieces.size() - uring.used_pieces >= SocketWriter::kMaxPieces;
}

void write_batch(Uring& uring) {
  while (io_uring_sq_ready(&uring.ring) > 0) {
    const int written = io_uring_submit(&uring.ring);
    if (written < 0 && written != -EINTR && written != -EAGAIN && written != -EBUSY)  // Not observed in practice.
      throw std::system_error(-written, std::generic_category(), "io_uring");
  }
  uring.used_pieces = uring.used_messages = 0;
}

void tell_writers(Uring& uring) {
  for (io_uring_cqe* done; io_uring_peek_cqe(&uring.ring, &done) == 0; io_uring_cqe_seen(&uring.ring, done)) {
    const std::uint64_t data = io_uring_cqe_get_data64(done);
    auto* writer = reinterpret_cast<SocketWriter*>(data & ~kSend);
    const auto outcome = Transport::outcome_of(done->res, Transport::Wait::kWritable);
    (data & kSend) != 0 ? writer->sent(outcome) : writer->written(outcome);
  }
}

#else

struct Uring {};

Result<std::shared_ptr<Uring>> open_uring() {
  return fail(ErrorCode::kUnsupported, "this program was built without liburing");
}

void add_send(Uring&, SocketWriter&, int, ByteView, bool) {}
bool add_pieces(Uring&, SocketWriter&, int) {
  return false;
}
bool has_room(const Uring&) {
  return true;
}
void write_batch(Uring&) {}
void tell_writers(Uring&) {}

#endif

}  // namespace eigencast::broker
