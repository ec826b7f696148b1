// SPDX-License-Identifier: MIT
#include "common/spectral/shift_invert.h"

#include <gtest/gtest.h>

#include <Eigen/SparseCholesky>
#include <algorithm>
#include <vector>

#include "common/spectral/laplacian.h"
#include "support.h"

namespace eigencast {
namespace {

using Permutation = EliminationOrder::PermutationType;

Eigen::Index entries_of_factor(const Eigen::SparseMatrix<double>& S, const Permutation& inverse) {
  Eigen::SparseMatrix<double> ordered = S;
  if (inverse.size() > 0) ordered = S.twistedBy(inverse.inverse());
  Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>, Eigen::Lower, Eigen::NaturalOrdering<int>> ldlt;
  ldlt.setShift(1);
  ldlt.compute(ordered);
  EXPECT_EQ(ldlt.info(), Eigen::Success);
  return ldlt.matrixL().nestedExpression().nonZeros();
}

/// Each row once, the same order each time; and a factor as sparse as minimum degree's to a quarter, where rows as they
/// come fill more than twice as much.
TEST(EliminationOrder, DissectsASurface) {
  const auto laplacian = build_laplacian(make_icosphere(4));
  ASSERT_TRUE(laplacian);
  const Eigen::SparseMatrix<double>& S = laplacian->L;
  Permutation dissected, again, degree;
  EliminationOrder(0)(S, dissected);
  EliminationOrder(0)(S, again);
  EliminationOrder()(S, degree);
  std::vector<int> rows(dissected.indices().begin(), dissected.indices().end());
  EXPECT_TRUE(std::equal(rows.begin(), rows.end(), again.indices().begin(), again.indices().end()));
  EXPECT_FALSE(std::equal(rows.begin(), rows.end(), degree.indices().begin(), degree.indices().end()));
  std::sort(rows.begin(), rows.end());
  ASSERT_EQ(static_cast<Eigen::Index>(rows.size()), S.rows());
  for (int row = 0; row < static_cast<int>(rows.size()); ++row) EXPECT_EQ(rows[static_cast<std::size_t>(row)], row);
  const Eigen::Index least = entries_of_factor(S, degree);
  EXPECT_LE(entries_of_factor(S, dissected), least + least / 4);
  EXPECT_GE(entries_of_factor(S, {}), 2 * least);
}

}  // namespace
}  // namespace eigencast
