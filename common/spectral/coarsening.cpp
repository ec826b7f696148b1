// SPDX-License-Identifier: MIT
#include "common/spectral/coarsening.h"

#include <vector>

namespace eigencast {
namespace {

constexpr double kDamping = 0.66;  // of Jacobi's step, in units of 1 / diagonal
constexpr int kFree = -1;

using RowMatrix = Eigen::SparseMatrix<double, Eigen::RowMajor>;
using Entry = Eigen::SparseMatrix<double>::InnerIterator;

/// The aggregate of each vertex, from 0, and their number.
struct Aggregates {
  std::vector<int> of;
  int count = 0;
};

Aggregates aggregate(const Eigen::SparseMatrix<double>& L) {
  const int n = static_cast<int>(L.cols());
  Aggregates result{std::vector<int>(static_cast<std::size_t>(n), kFree), 0};
  const auto of = [&](Eigen::Index i) -> int& { return result.of[static_cast<std::size_t>(i)]; };
  for (int i = 0; i < n; ++i) {
    bool all_free = of(i) == kFree;
    for (Entry it(L, i); it && all_free; ++it) all_free = of(it.row()) == kFree;
    if (!all_free) continue;
    for (Entry it(L, i); it; ++it) of(it.row()) = result.count;
    of(i) = result.count++;
  }
  // A free vertex joins the aggregate of its strongest neighbour; it has a neighbour in one, or it would be one itself.
  const std::vector<int> before = result.of;
  for (int i = 0; i < n; ++i) {
    if (of(i) != kFree) continue;
    double strongest = 0;
    for (Entry it(L, i); it; ++it) {
      const int other = before[static_cast<std::size_t>(it.row())];
      if (other == kFree || (of(i) != kFree && -it.value() <= strongest)) continue;
      strongest = -it.value();
      of(i) = other;
    }
    if (of(i) == kFree) of(i) = result.count++;
  }
  return result;
}

}  // namespace

Coarsened coarsen(const Laplacian& fine) {
  const Aggregates aggregates = aggregate(fine.L);
  const Eigen::Index n = fine.L.rows();
  RowMatrix indicators(n, aggregates.count);
  indicators.reserve(Eigen::VectorXi::Ones(n));
  Coarsened coarse;
  coarse.laplacian.mass = Eigen::VectorXd::Zero(aggregates.count);
  for (Eigen::Index i = 0; i < n; ++i) {
    const int a = aggregates.of[static_cast<std::size_t>(i)];
    indicators.insert(i, a) = 1;
    coarse.laplacian.mass[a] += fine.mass[i];
  }
  const Eigen::VectorXd step = fine.L.diagonal().unaryExpr([](double d) { return d > 0 ? kDamping / d : 0.0; });
  const RowMatrix L = fine.L;
  coarse.P = indicators - RowMatrix(step.asDiagonal() * RowMatrix(L * indicators));
  const RowMatrix LP = L * coarse.P;
  coarse.laplacian.L = RowMatrix(RowMatrix(coarse.P.transpose()) * LP);
  coarse.laplacian.area = fine.area;
  coarse.laplacian.components = fine.components;
  coarse.laplacian.bridges = fine.bridges;
  return coarse;
}

}  // namespace eigencast
