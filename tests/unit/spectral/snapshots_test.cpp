// SPDX-License-Identifier: MIT
#include "common/spectral/snapshots.h"

#include <gtest/gtest.h>

#include <cmath>

#include "common/spectral/symmetric_form.h"
#include "support.h"

namespace eigencast {
namespace {

constexpr std::size_t kVertices = 200;

std::vector<double> sample_weights() {
  std::mt19937 random(3);
  std::vector<double> weights;
  for (std::size_t i = 0; i < kVertices; ++i) weights.push_back(0.2 + testing::uniform(random));
  return weights;
}

/// Combinations of ten fixed columns, the later ones ever smaller.
std::vector<double> sample_field(unsigned number) {
  std::mt19937 random(100 + number);
  std::vector<double> field(3 * kVertices);
  for (int j = 1; j <= 10; ++j) {
    const double along = testing::uniform(random) - 0.5;
    for (std::size_t i = 0; i < field.size(); ++i)
      field[i] += along / (j * j) * std::cos(0.013 * static_cast<double>(j * (i / 3)) + j * static_cast<double>(i % 3));
  }
  return field;
}

/// The roots of the weights times the columns of fields: n x 3 fields.
Eigen::MatrixXd columns_of(const std::vector<std::vector<double>>& fields) {
  const std::vector<double> weights = sample_weights();
  Eigen::MatrixXd columns(static_cast<Eigen::Index>(kVertices), static_cast<Eigen::Index>(3 * fields.size()));
  for (std::size_t f = 0; f < fields.size(); ++f) {
    for (std::size_t i = 0; i < fields[f].size(); ++i) {
      columns(static_cast<Eigen::Index>(i / 3), static_cast<Eigen::Index>(3 * f + i % 3)) =
          std::sqrt(weights[i / 3]) * fields[f][i];
    }
  }
  return columns;
}

TEST(Snapshots, GramIsOfTheFieldsThatAreKept) {
  constexpr std::size_t kMost = 6;
  Snapshots snapshots(sample_weights(), kMost);
  std::vector<std::vector<double>> all;
  for (unsigned number = 0; number < 40; ++number) {
    all.push_back(sample_field(number));
    const bool is_due = snapshots.is_due(), is_full = snapshots.is_full();
    const std::size_t before = snapshots.count();
    snapshots.add(all.back());
    ASSERT_EQ(snapshots.count(), !is_due ? before : is_full ? before / 2 + 1 : before + 1);
    ASSERT_LE(snapshots.count(), kMost);
    ASSERT_EQ((snapshots.count() - 1) * snapshots.stride() + number % snapshots.stride(), number)
        << "evenly spaced, up to the last";
    std::vector<std::vector<double>> kept;
    for (std::size_t s = 0; s < snapshots.count(); ++s) kept.push_back(all[s * snapshots.stride()]);
    const Eigen::MatrixXd columns = columns_of(kept);
    EXPECT_LT((snapshots.gram() - columns.transpose() * columns).norm(), 1e-12 * columns.squaredNorm());
  }
  EXPECT_EQ(snapshots.stride(), 8u);
}

TEST(Snapshots, ComponentsAreOrthonormalAndLeaveTheSmallestResidual) {
  Snapshots snapshots(sample_weights(), 20);
  std::vector<std::vector<double>> fields;
  for (unsigned number = 0; number < 8; ++number) {
    fields.push_back(sample_field(number));
    snapshots.add(fields.back());
  }
  const Eigen::MatrixXd columns = columns_of(fields);
  double before = columns.squaredNorm();
  for (const Eigen::Index most : {1, 3, 6}) {
    const Components found = components_of(snapshots.gram(), most);
    ASSERT_EQ(found.T.cols(), most);
    const Eigen::MatrixXd H = snapshots.combined(found.T);
    EXPECT_LT((H.transpose() * H - Eigen::MatrixXd::Identity(most, most)).cwiseAbs().maxCoeff(), 1e-6);
    // Eckart & Young 1936, "The approximation of one matrix by another of lower rank".
    const DenseEigen all = dense_eigen(columns.transpose() * columns);
    const double left = (columns - H * (H.transpose() * columns)).squaredNorm();
    EXPECT_NEAR(left, all.values.head(columns.cols() - most).sum(), 1e-9 * columns.squaredNorm());
    EXPECT_NEAR(left, columns.squaredNorm() - found.squares.sum(), 1e-9 * columns.squaredNorm());
    EXPECT_LT(left, before);
    before = left;
  }
}

TEST(Snapshots, ComponentsAreAsManyAsTheColumnsHave) {
  Snapshots snapshots(sample_weights(), 8);
  for (unsigned number = 0; number < 8; ++number) snapshots.add(sample_field(0));
  EXPECT_EQ(components_of(snapshots.gram(), 20).T.cols(), 3) << "one pose has three columns";
  Snapshots still(sample_weights(), 8);
  still.add(std::vector<double>(3 * kVertices));
  EXPECT_EQ(components_of(still.gram(), 20).T.cols(), 0);
}

}  // namespace
}  // namespace eigencast
