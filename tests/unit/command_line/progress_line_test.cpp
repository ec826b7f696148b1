// SPDX-License-Identifier: MIT
#include "common/command_line/progress.h"

#include <gtest/gtest.h>

namespace eigencast {
namespace {

TEST(ProgressLine, StatesStageFractionAndTimeLeft) {
  const std::string line = ProgressLine::text(0.25, "eigenpairs", 5'000'000);
  EXPECT_NE(line.find("eigenpairs"), std::string::npos);
  EXPECT_NE(line.find(" 25 %"), std::string::npos);
  EXPECT_NE(line.find("15 s left"), std::string::npos);
}

TEST(ProgressLine, NoEstimateFromTooLittle) {
  EXPECT_EQ(ProgressLine::text(0.01, "x", 5'000'000).find("left"), std::string::npos);
  EXPECT_EQ(ProgressLine::text(0.50, "x", 500'000).find("left"), std::string::npos);
  EXPECT_EQ(ProgressLine::text(1.00, "x", 5'000'000).find("left"), std::string::npos);
}

TEST(ProgressLine, BarHasFixedWidth) {
  for (const double fraction : {-1.0, 0.0, 0.999, 1.0, 7.0}) {
    const std::string line = ProgressLine::text(fraction, "x", 0);
    EXPECT_EQ(line.find(']') - line.find('['), 31u);
  }
}

}  // namespace
}  // namespace eigencast
