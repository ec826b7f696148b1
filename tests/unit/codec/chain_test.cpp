// SPDX-License-Identifier: MIT
#include "common/codec/chain.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace eigencast {
namespace {

/// A smooth random motion of r coefficients that fall off with the row, as those of a surface do.
class Motion {
 public:
  explicit Motion(CoefficientLayout layout) : layout_(std::move(layout)) {}

  std::vector<double> at(double time) const {
    std::vector<double> C(layout_.size());
    for (std::size_t i = 0; i < C.size(); ++i) {
      const auto row = static_cast<double>(i / layout_.channels);
      C[i] = 1000 / (1 + row) * std::sin(0.2 * time + static_cast<double>(i)) +
             3 * std::sin(1.7 * time * (1 + 0.01 * row));
    }
    return C;
  }
  Key key(double time, std::uint8_t step) const { return key_from_coefficients(layout_, at(time), step).value(); }

 private:
  CoefficientLayout layout_;
};

CoefficientLayout layout_of(CodecKind codec, std::uint32_t rows = 60, std::uint32_t channels = 3) {
  return {codec, rows, channels, default_band_ends(rows)};
}

class EachCodec : public testing::TestWithParam<CodecKind> {};
INSTANTIATE_TEST_SUITE_P(Codecs, EachCodec,
                         testing::Values(CodecKind::kFloat64, CodecKind::kFloat32, CodecKind::kQuantised),
                         [](const auto& codec) { return std::string(name_of(codec.param)); });

TEST_P(EachCodec, ChainDecodesToWhatWasCodedAcrossStepChanges) {
  const CoefficientLayout layout = layout_of(GetParam());
  const Motion motion(layout);
  ChainState sender = advanced(std::nullopt, motion.key(0, 150), 0);
  auto receiver = decode_join(layout, layout.all_bands(), encode_join(layout, sender).value());
  ASSERT_TRUE(receiver) << receiver.error().message;
  ASSERT_EQ(*receiver, sender);
  for (int frame = 1; frame < 60; ++frame) {
    const Key key = motion.key(frame, static_cast<std::uint8_t>(150 + frame / 7 * 3 % 11));
    const Bytes payload = encode_key(layout, sender, key).value();
    const auto decoded = decode_key(layout, layout.all_bands(), *receiver, payload);
    ASSERT_TRUE(decoded) << decoded.error().message;
    ASSERT_EQ(*decoded, key);
    sender = advanced(sender, key, 33'333);
    receiver = advanced(*receiver, *decoded, 33'333);

    const auto joiner = decode_join(layout, layout.all_bands(), encode_join(layout, sender).value());
    ASSERT_TRUE(joiner) << joiner.error().message;
    ASSERT_EQ(*joiner, *receiver);
  }
}

}  // namespace
}  // namespace eigencast
