// SPDX-License-Identifier: MIT
#pragma once

#include <Eigen/SparseCore>

namespace eigencast {

/// The order in which a sparse symmetric matrix is eliminated, so that its factor stays sparse: an ordering as Eigen's
/// sparse factorisations take it. Small matrices: approximate minimum degree (Amestoy, Davis, Duff 1996, "An
/// approximate minimum degree ordering algorithm"), which is quick; large ones: nested dissection (Karypis, Kumar 1998,
/// "A fast and high quality multilevel scheme for partitioning irregular graphs"), whose factor of a surface of a
/// million vertices has two thirds of the entries and takes a third of the time. The same matrix gives the same order.
///
/// METIS handles SIGTERM and SIGABRT while it works (seconds): block SIGTERM in other threads.
class EliminationOrder {
 public:
  using PermutationType = Eigen::PermutationMatrix<Eigen::Dynamic, Eigen::Dynamic, int>;
  static constexpr Eigen::Index kLarge = 250'000;  ///< rows from which nested dissection is worth its time

  explicit EliminationOrder(Eigen::Index large = kLarge) : large_(large) {}
  /// S: n x n, both triangles stored. inverse: row inverse[k] of S is eliminated k-th.
  void operator()(const Eigen::SparseMatrix<double>& S, PermutationType& inverse) const;

 private:
  Eigen::Index large_;
};

}  // namespace eigencast
