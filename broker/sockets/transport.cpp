// SPDX-License-Identifier: MIT
#include "broker/sockets/transport.h"

#include <linux/sockios.h>
#include <netinet/tcp.h>
#include <openssl/err.h>
#include <openssl/evp.h>
#include <openssl/ssl.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>

#include "broker/sockets/kernel_buffer.h"
#include "broker/sockets/peer_window.h"
#include "common/core/bytes.h"

namespace eigencast::broker {
namespace {

constexpr std::size_t kRecordBytes = 16 * 1024;  // Payload of one TLS record.
/// A handshake takes six; each further one, a new key, stands for 2^24 records (RFC 8446, 5.5), and takes 40 us.
constexpr std::uintptr_t kMaxHandshakeMessages = 64;

/// In the application data of a connection: its lowest byte counts the peer's handshake messages, refusals of them, and
/// records of the first handshake; above it are the peer's records since they were taken.
constexpr std::uintptr_t kRecord = 256;

std::uintptr_t counts_of(const SSL* tls) {
  return reinterpret_cast<std::uintptr_t>(SSL_get_app_data(tls));
}

/// Too many handshake messages are the connection's end, also of the SSL_accept or SSL_read that works through them.
void count_records(int is_sent, int, int type, const void*, std::size_t, SSL* tls, void*) {
  const bool is_record = is_sent == 0 && type == SSL3_RT_HEADER;
  const bool is_handshake =
      type == (is_sent != 0 ? SSL3_RT_ALERT : SSL3_RT_HANDSHAKE) || (is_record && SSL_in_init(tls) != 0);
  std::uintptr_t counts = counts_of(tls) + (is_record ? kRecord : 0);
  if (is_handshake && counts % kRecord <= kMaxHandshakeMessages) ++counts;
  SSL_set_app_data(tls, reinterpret_cast<void*>(counts));
  if (counts % kRecord > kMaxHandshakeMessages) SSL_set_shutdown(tls, SSL_RECEIVED_SHUTDOWN);
}

/// The first bytes of all pieces in one span; copies only if there are several pieces.
ByteView gathered(std::span<const iovec> pieces, std::array<std::uint8_t, kRecordBytes>& scratch) {
  if (pieces.size() == 1) {
    return {static_cast<const std::uint8_t*>(pieces[0].iov_base), std::min(pieces[0].iov_len, kRecordBytes)};
  }
  std::size_t used = 0;
  for (const iovec& piece : pieces) {
    const std::size_t count = std::min(piece.iov_len, kRecordBytes - used);
    std::memcpy(scratch.data() + used, piece.iov_base, count);
    used += count;
  }
  return ByteView(scratch).first(used);
}

}  // namespace

Transport::Outcome Transport::outcome_of(std::int64_t result, Wait wait) {
  if (result >= 0) return {static_cast<std::size_t>(result), Wait::kNo, {}};
  if (result == -EAGAIN || result == -EWOULDBLOCK || result == -EINTR) return {0, wait, {}};
  return {0, Wait::kNo, ErrorOf(static_cast<int>(-result), boost::system::system_category())};
}

void Transport::FreeTls::operator()(SSL* tls) const {
  SSL_free(tls);
}

Transport::Transport(Socket socket, std::shared_ptr<SSL_CTX> context)
    : socket_(std::move(socket)), tls_(SSL_new(context.get())) {
  ErrorOf ignored;
  socket_.native_non_blocking(true, ignored);
  tls_failed_ = !tls_ || SSL_set_fd(tls_.get(), socket_.native_handle()) != 1;
  if (tls_failed_) return;
  SSL_set_mode(tls_.get(),
               SSL_MODE_RELEASE_BUFFERS | SSL_MODE_ENABLE_PARTIAL_WRITE | SSL_MODE_ACCEPT_MOVING_WRITE_BUFFER);
  SSL_clear_mode(tls_.get(), SSL_MODE_AUTO_RETRY);  // Records without data must not hold up the loop.
  SSL_set_msg_callback(tls_.get(), count_records);
  SSL_set_accept_state(tls_.get());
}

Transport::Transport(asio::io_context& loop, Transport other)
    : socket_(loop.get_executor()),
      tls_(std::move(other.tls_)),
      tls_failed_(other.tls_failed_),
      wide_(std::move(other.wide_)) {
  ErrorOf error;
  const Tcp protocol = other.socket_.local_endpoint(error).protocol();
  const int socket = other.socket_.release(error);
  if (error) return;  // Every call fails and the connection ends.
  socket_.assign(protocol, socket, error);
  if (error) ::close(socket);
}

Transport::Outcome Transport::tls_outcome(int result) {
  if (result > 0) return {static_cast<std::size_t>(result), Wait::kNo, {}};
  const int number = errno;
  const int what = SSL_get_error(tls_.get(), result);
  if (what == SSL_ERROR_WANT_READ) return {0, Wait::kReadable, {}};
  if (what == SSL_ERROR_WANT_WRITE) return {0, Wait::kWritable, {}};
  const bool ended = what == SSL_ERROR_ZERO_RETURN || (what == SSL_ERROR_SYSCALL && (number == 0 || result == 0));
  if (what != SSL_ERROR_ZERO_RETURN) tls_failed_ = true;  // Such a connection must not be shut down.
  ERR_clear_error();
  if (ended) return {0, Wait::kNo, asio::error::eof};
  if (what == SSL_ERROR_SYSCALL) return {0, Wait::kNo, ErrorOf(number, boost::system::system_category())};
  return {0, Wait::kNo, asio::error::connection_aborted};
}

Transport::Outcome Transport::shake_hands() {
  if (tls_failed_) return {0, Wait::kNo, asio::error::connection_aborted};
  if (!tls_) return {};
  ERR_clear_error();
  Outcome outcome = tls_outcome(SSL_accept(tls_.get()));
  outcome.bytes = 0;
  return outcome;
}

double Transport::handshake_us() const {
  constexpr double kExchangeUs = 300, kRsa2048Us = 380, kLargeCurveUs = 1500;
  EVP_PKEY* const key = tls_ ? SSL_get_privatekey(tls_.get()) : nullptr;
  if (key == nullptr) return kExchangeUs;
  const int bits = EVP_PKEY_get_bits(key);
  if (EVP_PKEY_is_a(key, "EC") != 0 || bits <= 512) return kExchangeUs + (bits > 256 ? kLargeCurveUs : 0);
  const double size = bits / 2048.0;
  return kExchangeUs + kRsa2048Us * size * size * size;
}

bool Transport::asks_for_certificates() const {
  return tls_ && SSL_get_verify_mode(tls_.get()) != SSL_VERIFY_NONE;
}

std::size_t Transport::take_records() {
  if (!tls_) return 0;
  const std::uintptr_t counts = counts_of(tls_.get());
  SSL_set_app_data(tls_.get(), reinterpret_cast<void*>(counts % kRecord));
  return counts / kRecord;
}

Transport::Outcome Transport::read(std::span<std::uint8_t> into) {
  if (into.empty()) return {};
  if (tls_) {
    if (tls_failed_) return {0, Wait::kNo, asio::error::eof};
    ERR_clear_error();
    errno = 0;
    return tls_outcome(
        SSL_read(tls_.get(), into.data(), static_cast<int>(std::min<std::size_t>(into.size(), 1 << 30))));
  }
  const ssize_t count = ::recv(socket_.native_handle(), into.data(), into.size(), MSG_DONTWAIT);
  if (count == 0) return {0, Wait::kNo, asio::error::eof};
  return outcome_of(count < 0 ? -errno : count, Wait::kReadable);
}

bool Transport::has_read_ahead() const {
  return tls_ && !tls_failed_ && SSL_pending(tls_.get()) > 0;
}

Transport::Outcome Transport::write(std::span<const iovec> pieces) {
  if (tls_) return write_tls(pieces);
  if (pieces.size() == 1) {
    const auto* bytes = static_cast<const std::uint8_t*>(pieces[0].iov_base);
    return outcome_of(send({bytes, pieces[0].iov_len}), Wait::kWritable);
  }
  msghdr message{};
  message.msg_iov = const_cast<iovec*>(pieces.data());
  message.msg_iovlen = pieces.size();
  const ssize_t count = ::sendmsg(socket_.native_handle(), &message, kSendFlags);
  return outcome_of(count < 0 ? -errno : count, Wait::kWritable);
}

Transport::Outcome Transport::write_tls(std::span<const iovec> pieces) {
  if (tls_failed_) return {0, Wait::kNo, asio::error::eof};
  std::array<std::uint8_t, kRecordBytes> scratch;
  ByteView bytes = gathered(pieces, scratch);
  if (held_ > 0) bytes = bytes.first(held_);
  if (bytes.empty()) return {};
  ERR_clear_error();
  errno = 0;
  const Outcome outcome = tls_outcome(SSL_write(tls_.get(), bytes.data(), static_cast<int>(bytes.size())));
  held_ = outcome.wait == Wait::kNo ? 0 : bytes.size();
  return outcome;
}

void Transport::end_writing() {
  if (tls_ && !tls_failed_ && SSL_is_init_finished(tls_.get())) {
    SSL_shutdown(tls_.get());
    ERR_clear_error();
  }
  ErrorOf ignored;
  socket_.shutdown(Tcp::socket::shutdown_send, ignored);
}

void Transport::close() {
  ErrorOf ignored;
  socket_.close(ignored);
}

void Transport::reset() {
  ErrorOf ignored;
  socket_.set_option(Socket::linger(true, 0), ignored);
  close();
}

std::size_t Transport::unacknowledged() {
  int bytes = 0;
  const bool some = socket_.is_open() && ::ioctl(socket_.native_handle(), SIOCOUTQ, &bytes) == 0 && bytes > 0 &&
                    !is_reset(socket_.native_handle());
  return some ? static_cast<std::size_t>(bytes) : 0;
}

std::size_t Transport::unread() {
  ErrorOf gone;
  const std::size_t bytes = socket_.available(gone);
  return gone ? 0 : bytes;
}

void Transport::widen_receive_buffer(std::shared_ptr<void> held) {
  if (wide_) return;
  wide_ = std::move(held);
  const int most = wide_ ? kWideBytes : kSocketBytes;
  ErrorOf ignored;
  const int socket = socket_.native_handle();
  bool grows = fix_buffer(socket, KernelBuffer::kReceive, false);
  if (grows) {
    // SO_RCVBUF allows no more than net.core.rmem_max, mostly 208 KiB. This makes room for a window, whose memory
    // depends on the packets that came.
    constexpr int kWindow = 2 * kReceiveBytes;
    socket_.set_option(Socket::receive_low_watermark(kWindow), ignored);
    Socket::receive_buffer_size size;
    socket_.get_option(size, ignored);
    grows = !ignored && size.value() <= most;
    const int window = grows ? static_cast<int>(std::int64_t{most} * kWindow / size.value()) : 1;
    socket_.set_option(Socket::receive_low_watermark(window), ignored);
    socket_.set_option(Socket::receive_low_watermark(1), ignored);
  }
  if (grows) return void(fix_buffer(socket, KernelBuffer::kReceive, true));
  socket_.set_option(Socket::receive_buffer_size(most / 2), ignored);
  socket_.set_option(asio::detail::socket_option::integer<IPPROTO_TCP, TCP_WINDOW_CLAMP>(most / 2), ignored);
}

void Transport::limit_unsent(int bytes) {
  ErrorOf ignored;
  socket_.set_option(asio::detail::socket_option::integer<IPPROTO_TCP, TCP_NOTSENT_LOWAT>(bytes), ignored);
}

void Transport::limit_send_buffer(int bytes) {
  ErrorOf ignored;
  if (bytes > 0) return void(socket_.set_option(Socket::send_buffer_size(bytes), ignored));
  (void)fix_buffer(socket_.native_handle(), KernelBuffer::kSend, false);
}

}  // namespace eigencast::broker
