// SPDX-License-Identifier: MIT
#include "common/spectral/elimination_order.h"

#include <metis.h>

#include <Eigen/OrderingMethods>
#include <vector>

namespace eigencast {
namespace {

/// False where METIS is out of memory.
bool dissect(const Eigen::SparseMatrix<double>& S, EliminationOrder::PermutationType& inverse) {
  auto n = static_cast<idx_t>(S.rows());
  std::vector<idx_t> first{0}, neighbours;
  first.reserve(static_cast<std::size_t>(n) + 1);
  neighbours.reserve(static_cast<std::size_t>(S.nonZeros()));
  for (int column = 0; column < S.outerSize(); ++column) {
    for (Eigen::SparseMatrix<double>::InnerIterator it(S, column); it; ++it) {
      if (it.row() != column) neighbours.push_back(static_cast<idx_t>(it.row()));
    }
    first.push_back(static_cast<idx_t>(neighbours.size()));
  }
  std::vector<idx_t> order(static_cast<std::size_t>(n)), inverse_order(static_cast<std::size_t>(n));
  if (METIS_NodeND(&n, first.data(), neighbours.data(), nullptr, nullptr, order.data(), inverse_order.data()) !=
      METIS_OK)
    return false;
  inverse.resize(n);
  for (idx_t k = 0; k < n; ++k) inverse.indices()[k] = static_cast<int>(order[static_cast<std::size_t>(k)]);
  return true;
}

}  // namespace

void EliminationOrder::operator()(const Eigen::SparseMatrix<double>& S, PermutationType& inverse) const {
  if (S.rows() >= large_ && dissect(S, inverse)) return;
  Eigen::AMDOrdering<int>()(S, inverse);
}

}  // namespace eigencast
