// SPDX-License-Identifier: MIT
#include "broker/websocket/reader.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <string>
#include <vector>

#include "broker/websocket/protocol.h"

namespace eigencast::broker::websocket {
namespace {

using Kind = MessageReader::Event::Kind;

struct Seen {
  Kind kind;
  std::string payload;
  CloseCode code;
  bool operator==(const Seen&) const = default;
};

std::ostream& operator<<(std::ostream& out, const Seen& seen) {
  return out << static_cast<int>(seen.kind) << " '" << seen.payload.substr(0, 20) << "' "
             << static_cast<int>(seen.code);
}

/// A client's frame.
std::string frame(unsigned first, std::string payload, bool masked = true) {
  std::string out{static_cast<char>(first)};
  const auto mask_bit = masked ? 0x80u : 0u;
  if (payload.size() < 126) {
    out += static_cast<char>(mask_bit | payload.size());
  } else if (payload.size() < 65'536) {
    out += static_cast<char>(mask_bit | 126u);
    out += {static_cast<char>(payload.size() >> 8), static_cast<char>(payload.size())};
  } else {
    out += static_cast<char>(mask_bit | 127u);
    for (int i = 7; i >= 0; --i) out += static_cast<char>(payload.size() >> (8 * i));
  }
  const std::string mask = "\x11\x92\x73\xf4";
  if (masked) out += mask;
  for (std::size_t i = 0; i < payload.size() && masked; ++i) payload[i] = static_cast<char>(payload[i] ^ mask[i % 4]);
  return out + payload;
}

constexpr unsigned kFin = 0x80;
constexpr unsigned kText = 1, kBinary = 2, kClose = 8, kPing = 9, kPong = 10;

std::string close_of(unsigned code, const std::string& reason = {}) {
  return frame(kFin | kClose, std::string{static_cast<char>(code >> 8), static_cast<char>(code)} + reason);
}

/// What a reader makes of a stream that comes in pieces of `step` bytes.
std::vector<Seen> read(std::string stream, std::size_t step, const MessageReader::Limits& limits = {1 << 20, 1 << 20}) {
  MessageReader reader(limits);
  std::vector<Seen> all;
  for (std::size_t at = 0; at < stream.size(); at += step) {
    Bytes piece(stream.begin() + static_cast<std::ptrdiff_t>(at),
                stream.begin() + static_cast<std::ptrdiff_t>(std::min(at + step, stream.size())));
    std::span<std::uint8_t> input(piece);
    while (const auto event = reader.next(input, 0)) {
      if (event->kind == Kind::kFrame) continue;
      all.push_back({event->kind, {event->payload.begin(), event->payload.end()}, event->code});
    }
    EXPECT_TRUE(input.empty());
  }
  return all;
}

/// The same, whatever the pieces.
std::vector<Seen> read(const std::string& stream) {
  const auto whole = read(stream, stream.size());
  for (const std::size_t step : {1, 2, 3, 7, 64, 1000}) EXPECT_EQ(read(stream, step), whole) << "pieces of " << step;
  return whole;
}

Seen message(Kind kind, const std::string& payload) {
  return {kind, payload, CloseCode::kNone};
}

std::vector<Seen> failure(CloseCode code) {
  return {{Kind::kFailed, {}, code}};
}

TEST(MessageReaderTest, EveryFrameIsReportedBeforeItsPayload) {
  const std::string stream = frame(kText, "ab") + frame(0, "") + frame(kFin | kPing, "x") + frame(0, "") +
                             frame(kFin, "c") + frame(kFin | kBinary, std::string(300, 'y'));
  for (const std::size_t step : {std::size_t{1}, std::size_t{5}, stream.size()}) {
    MessageReader reader({1 << 20, 1 << 20});
    std::string seen;
    for (std::size_t at = 0; at < stream.size(); at += step) {
      std::string piece = stream.substr(at, step);
      Bytes bytes(piece.begin(), piece.end());
      std::span<std::uint8_t> input(bytes);
      while (const auto event = reader.next(input, 0)) {
        if (event->kind == Kind::kFrame) {
          seen += std::to_string(static_cast<int>(event->opcode)) + (event->last ? "." : "-") +
                  std::to_string(event->bytes) + "+" + std::to_string(event->before) + " ";
        } else {
          seen += "=" + std::to_string(event->payload.size()) + " ";
        }
      }
    }
    EXPECT_EQ(seen, "1-2+0 1-0+2 9.1+0 =1 1-0+2 1.1+2 =3 2.300+0 =300 ") << step;
  }
}

TEST(MessageReaderTest, MemoryOfAnIncompleteMessageIsKnown) {
  MessageReader reader({1 << 20, 1 << 20});
  const auto take = [&](std::string text) {
    Bytes bytes(text.begin(), text.end());
    std::span<std::uint8_t> input(bytes);
    std::size_t events = 0;
    while (const auto event = reader.next(input, 0)) events += event->kind == Kind::kFrame ? 0 : 1;
    return events;
  };
  EXPECT_EQ(take(frame(kFin | kBinary, std::string(5000, 'x'))), 1u);
  EXPECT_EQ(reader.held_bytes(), 0u);
  EXPECT_EQ(take(frame(kBinary, std::string(5000, 'x'))), 0u);
  EXPECT_GE(reader.held_bytes(), 5000u);
  EXPECT_EQ(take(frame(kFin, "y")), 1u);
  EXPECT_EQ(reader.held_bytes(), 0u);
  EXPECT_EQ(take(frame(kBinary, std::string(5000, 'x'))), 0u);
  reader.stop();
  EXPECT_EQ(reader.held_bytes(), 0u);
  EXPECT_EQ(take(frame(kFin, "y") + frame(kFin | kPing, "")), 0u);
}

constexpr MessageReader::Limits kLimits;

/// Bytes that come at given times.
class Arrivals {
 public:
  void take(const std::string& text, TimeUs now_us) {
    Bytes bytes(text.begin(), text.end());
    std::span<std::uint8_t> input(bytes);
    while (reader.next(input, now_us)) continue;
  }
  MessageReader reader{kLimits};
};

constexpr TimeUs kSecond = 1'000'000;

TEST(MessageReaderTest, TricklesFallBehindWhateverComesBetween) {
  const std::string bytes = frame(kFin | kBinary, std::string(100'000, 'x')), head = bytes.substr(0, 14);
  for (const std::string& piece : {std::string("x"), frame(0, ""), frame(0, "x"), frame(kFin | kPing, "still here")}) {
    Arrivals slow;
    slow.take(piece == "x" ? head : frame(kBinary, "x"), 0);
    for (TimeUs at_us = 0; at_us <= 100 * kSecond; at_us += kSecond) slow.take(piece, at_us);
    EXPECT_GT(slow.reader.behind_us(100 * kSecond), 99 * kSecond) << "of " << piece.size() << " bytes each";
  }
  Arrivals burst;
  burst.take(bytes.substr(0, bytes.size() - 1), 0);
  EXPECT_EQ(burst.reader.behind_us(40 * kSecond), 40 * kSecond) << "what came early buys no time";
  burst.take(bytes.substr(bytes.size() - 1), 40 * kSecond);
  EXPECT_EQ(burst.reader.behind_us(1000 * kSecond), 0) << "it is whole";
  burst.take(head, 1000 * kSecond);
  EXPECT_EQ(burst.reader.behind_us(1001 * kSecond), kSecond) << "each for itself";
  burst.reader.stop();
  EXPECT_EQ(burst.reader.behind_us(2000 * kSecond), 0);
}

TEST(MessageReaderTest, LargestMessageKeepsUpOverSlowLink) {
  const std::string bytes = frame(kFin | kBinary, std::string(1 << 20, 'x'));
  Arrivals link;  // Of 64 kbit/s, with an outage.
  TimeUs now_us = 0;
  for (std::size_t at = 0; at < bytes.size(); at += 4000, now_us += kSecond / 2) {
    if (at == 400'000) now_us += 25 * kSecond;
    EXPECT_LE(link.reader.behind_us(now_us), 26 * kSecond) << at;
    link.take(bytes.substr(at, 4000), now_us);
  }
  EXPECT_GT(now_us, 150 * kSecond);
  EXPECT_EQ(link.reader.behind_us(now_us), 0);
}

TEST(MessageReaderTest, PausesAreExcusedOncePerMessage) {
  Arrivals paused;
  paused.take(frame(kBinary, "x"), 0);
  for (int i = 0; i < 3; ++i) paused.reader.excuse(10 * kSecond);
  EXPECT_EQ(paused.reader.behind_us(9 * kSecond), 0);
  EXPECT_EQ(paused.reader.behind_us(30 * kSecond), 20 * kSecond);
  paused.take(frame(kFin, "y") + frame(kBinary, "x"), 30 * kSecond);
  paused.reader.excuse(10 * kSecond);
  EXPECT_EQ(paused.reader.behind_us(40 * kSecond), 0);
}

TEST(MessageReaderTest, MessagesOfEverySizeRoundTrip) {
  for (const std::size_t size : {0, 1, 7, 8, 125, 126, 127, 128, 65'535, 65'536, 70'000}) {
    std::string payload(size, 'x');
    for (std::size_t i = 0; i < size; ++i) payload[i] = static_cast<char>('a' + i % 26);
    EXPECT_EQ(read(frame(kFin | kText, payload) + frame(kFin | kBinary, payload)),
              (std::vector<Seen>{message(Kind::kText, payload), message(Kind::kBinary, payload)}))
        << size;
  }
}

TEST(MessageReaderTest, FragmentsMayInterleaveWithControlFrames) {
  EXPECT_EQ(read(frame(kText, "ab") + frame(kFin | kPing, "p") + frame(0, "") + frame(0, "c") +
                 frame(kFin | kPong, "q") + frame(kFin, "d") + frame(kFin | kBinary, "e")),
            (std::vector<Seen>{message(Kind::kPing, "p"), message(Kind::kPong, "q"), message(Kind::kText, "abcd"),
                               message(Kind::kBinary, "e")}));
  EXPECT_EQ(read(frame(kText, "") + frame(0, "") + frame(kFin, "")), (std::vector<Seen>{message(Kind::kText, "")}));
}

TEST(MessageReaderTest, ProtocolViolationsAreRefused) {
  for (const unsigned reserved : {0x40u, 0x20u, 0x10u, 0x70u})
    EXPECT_EQ(read(frame(kFin | reserved | kText, "a")), failure(CloseCode::kProtocolError));
  for (const unsigned opcode : {3u, 4u, 5u, 6u, 7u, 11u, 12u, 13u, 14u, 15u})
    EXPECT_EQ(read(frame(kFin | opcode, "a")), failure(CloseCode::kProtocolError)) << opcode;
  EXPECT_EQ(read(frame(kFin | kText, "a", false)), failure(CloseCode::kProtocolError)) << "not masked";
  EXPECT_EQ(read(frame(kPing, "a")), failure(CloseCode::kProtocolError)) << "a ping in fragments";
  EXPECT_EQ(read(frame(kFin | kPing, std::string(126, 'a'))), failure(CloseCode::kProtocolError)) << "a long ping";
  EXPECT_EQ(read(frame(kFin, "a")), failure(CloseCode::kProtocolError)) << "a continuation of nothing";
  EXPECT_EQ(read(frame(0, "a")), failure(CloseCode::kProtocolError)) << "a continuation of nothing";
  EXPECT_EQ(read(frame(kText, "a") + frame(kFin | kText, "b")), failure(CloseCode::kProtocolError))
      << "a text in a text";
  const std::string long_form = std::string("\x81\xfe\x00\x05", 4) + std::string(9, 'a');
  EXPECT_EQ(read(long_form), failure(CloseCode::kProtocolError)) << "5 bytes, said in three";
  const std::string huge = std::string("\x82\xff\xff", 3) + std::string(11, '\xff');
  EXPECT_EQ(read(huge), failure(CloseCode::kProtocolError)) << "over 63 bits";
}

TEST(MessageReaderTest, BadHeadIsRefusedAtFirstByte) {
  MessageReader reader({});
  Bytes piece = {0x83};
  std::span<std::uint8_t> input(piece);
  const auto event = reader.next(input, 0);
  ASSERT_TRUE(event);
  EXPECT_EQ(event->kind, Kind::kFailed);
}

TEST(MessageReaderTest, TextMustBeUtf8) {
  const std::string good[] = {"\xce\xba\xe1\xbd\xb9\xcf\x83", "\xf0\x90\x80\x80\xf4\x8f\xbf\xbf",
                              "\xed\x9f\xbf\xee\x80\x80", "\xef\xbf\xbe", std::string(100, 'a') + "\xc2\x80"};
  for (const auto& text : good) {
    EXPECT_EQ(read(frame(kFin | kText, text)), (std::vector<Seen>{message(Kind::kText, text)}));
    const std::size_t half = text.size() / 2;
    EXPECT_EQ(read(frame(kText, text.substr(0, half)) + frame(kFin, text.substr(half))),
              (std::vector<Seen>{message(Kind::kText, text)}))
        << "a character over two fragments";
  }
  const std::string bad[] = {"\x80",
                             "\xc0\xaf",
                             "\xc1\xbf",
                             "\xe0\x80\xaf",
                             "\xed\xa0\x80",
                             "\xf0\x80\x80\xaf",
                             "\xf4\x90\x80\x80",
                             "\xf5\x80\x80\x80",
                             "\xfe",
                             "\xff",
                             "\xce\xce",
                             "abc\xce",
                             "\xf4\x8f\xbf"};
  for (const auto& text : bad) EXPECT_EQ(read(frame(kFin | kText, text)), failure(CloseCode::kBadPayload)) << text;
  EXPECT_EQ(read(frame(kFin | kBinary, "\xff\xfe")), (std::vector<Seen>{message(Kind::kBinary, "\xff\xfe")}));
}

TEST(MessageReaderTest, BadUtf8IsRefusedEarly) {
  const std::string stream = frame(kText, std::string("abc\xf4\x90") + std::string(100, 'a'));
  const std::string start = stream.substr(0, 6 + 5);
  EXPECT_EQ(read(start, start.size()), failure(CloseCode::kBadPayload));
  EXPECT_EQ(read(start, 1), failure(CloseCode::kBadPayload));
}

TEST(MessageReaderTest, LengthLimitsApplyToTheHeader) {
  const MessageReader::Limits limits{10, 20};
  EXPECT_EQ(read(frame(kFin | kText, std::string(10, 'a')), 4, limits).size(), 1u);
  EXPECT_EQ(read(frame(kFin | kText, std::string(11, 'a')), 4, limits), failure(CloseCode::kTooBig));
  EXPECT_EQ(read(frame(kFin | kBinary, std::string(20, 'a')), 4, limits).size(), 1u);
  EXPECT_EQ(read(frame(kFin | kBinary, std::string(21, 'a')), 4, limits), failure(CloseCode::kTooBig));
  EXPECT_EQ(read(frame(kText, "12345678") + frame(kFin, "123"), 4, limits), failure(CloseCode::kTooBig));
  const std::string declared = std::string("\x82\xff\x7f", 3) + std::string(7, '\xff') + "mask";
  EXPECT_EQ(read(declared, declared.size(), limits), failure(CloseCode::kTooBig));
}

TEST(MessageReaderTest, CloseFramesCarryTheirCode) {
  EXPECT_EQ(read(frame(kFin | kClose, "")), (std::vector<Seen>{{Kind::kClose, "", CloseCode::kNone}}));
  for (const unsigned code :
       {1000, 1001, 1002, 1003, 1007, 1008, 1009, 1010, 1011, 1012, 1013, 1014, 3000, 3999, 4000, 4999}) {
    EXPECT_EQ(read(close_of(code, "why")), (std::vector<Seen>{{Kind::kClose, "why", static_cast<CloseCode>(code)}}));
  }
  for (const unsigned code : {0, 999, 1004, 1005, 1006, 1015, 1016, 1100, 2000, 2999, 5000, 65'535})
    EXPECT_EQ(read(close_of(code)), failure(CloseCode::kProtocolError)) << code;
  EXPECT_EQ(read(frame(kFin | kClose, "\x03")), failure(CloseCode::kProtocolError));
  EXPECT_EQ(read(close_of(1000, "\xff")), failure(CloseCode::kBadPayload));
  EXPECT_EQ(read(frame(kFin | kClose, std::string(126, 'a'))), failure(CloseCode::kProtocolError));
  EXPECT_EQ(read(close_of(1000) + frame(kFin | kText, "after")).size(), 1u) << "nothing counts after a close";
}

TEST(ProtocolTest, FramedMessagesRoundTrip) {
  for (const std::size_t size : {0, 125, 126, 65'535, 65'536}) {
    std::string wire = *framed(Opcode::kBinary, std::string(size, 'x'));
    // A client masks; with the mask of zeros the rest stays as it is.
    const std::size_t head = size < 126 ? 2 : size < 65'536 ? 4 : 10;
    wire[1] = static_cast<char>(wire[1] | 0x80);
    wire.insert(head, 4, '\0');
    EXPECT_EQ(read(wire), (std::vector<Seen>{message(Kind::kBinary, std::string(size, 'x'))}));
  }
}

TEST(ProtocolTest, CloseReasonIsCutBetweenCharacters) {
  std::string reason(122, 'a');
  reason += "\xce\xba";
  EXPECT_EQ(framed_close(CloseCode::kPolicy, reason)->size(), 2u + 2 + 122);
  EXPECT_EQ(framed_close(CloseCode::kNone, "x")->size(), 2u);
}

TEST(UpgradeTest, AcceptKeyMatchesTheStandard) {
  EXPECT_NE(upgrade_answer("dGhlIHNhbXBsZSBub25jZQ==", "p", "s")
                .find("Sec-WebSocket-Accept: s3pPLMBiTxaQ9kYGzzhZRbK+xOo=\r\n"),
            std::string::npos);
  EXPECT_TRUE(is_key("dGhlIHNhbXBsZSBub25jZQ=="));
  for (const char* key :
       {"", "short==", "dGhlIHNhbXBsZSBub25jZQ=", "dGhlIHNhbXBsZSBub25jZ\r\n=", "dGhlIHNhbXBsZSBub25jZQAA"})
    EXPECT_FALSE(is_key(key)) << key;
}

}  // namespace
}  // namespace eigencast::broker::websocket
