// SPDX-License-Identifier: MIT
#include "common/spectral/panels.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cassert>
#include <cstring>
#include <new>

#include "common/core/worker_team.h"

namespace eigencast {

extern const PanelFunctions baseline_panel_functions;
#if defined(__x86_64__)
extern const PanelFunctions avx2_panel_functions;
extern const PanelFunctions avx512_panel_functions;
#endif

const PanelFunctions& panel_functions(InstructionSet set) {
#if defined(__x86_64__)
  if (set >= InstructionSet::kAvx512) return avx512_panel_functions;
  if (set == InstructionSet::kAvx2) return avx2_panel_functions;
#endif
  static_cast<void>(set);
  return baseline_panel_functions;
}
const PanelFunctions& panel_functions() {
  static const PanelFunctions& best = panel_functions(instruction_sets().back());
  return best;
}

namespace {

constexpr Eigen::Index kStripes = 8;       // of rows; no sum may depend on the number of threads
constexpr Eigen::Index kRowsAtOnce = 512;  // of a panel: 32 KiB
constexpr std::align_val_t kAlignment{64};

using PanelBlock = Eigen::Matrix<double, kWidth, kWidth, Eigen::RowMajor>;
using PanelMatrix = Eigen::Matrix<double, Eigen::Dynamic, kWidth, Eigen::RowMajor>;

/// work(stripe, first row, end row), stripes at the same time.
void for_stripes(Eigen::Index rows, const std::function<void(Eigen::Index, Eigen::Index, Eigen::Index)>& work) {
  for_panels(kStripes,
             [&](Eigen::Index stripe) { work(stripe, rows * stripe / kStripes, rows * (stripe + 1) / kStripes); });
}

std::vector<PanelBlock> blocks_of(const Eigen::MatrixXd& H, double factor) {
  std::vector<PanelBlock> blocks;
  for (Eigen::Index j = 0; j < H.rows(); j += kWidth) blocks.push_back(factor * H.middleRows(j, kWidth));
  return blocks;
}

}  // namespace

void for_panels(Eigen::Index count, const std::function<void(Eigen::Index)>& work) {
  worker_team().run(static_cast<std::size_t>(count), [&](std::size_t j) { work(static_cast<Eigen::Index>(j)); });
}

void Panels::Free::operator()(double* at) const {
  ::operator delete(at, kAlignment);
}

double* Panels::append() {
  const std::size_t bytes = static_cast<std::size_t>(rows_) * kPanelWidth * sizeof(double);
  panels_.emplace_back(static_cast<double*>(::operator new(bytes, kAlignment)));
  std::memset(panels_.back().get(), 0, bytes);
  return panels_.back().get();
}

void copy_column(const Panels& from, Eigen::Index i, Panels& to, Eigen::Index j) {
  for (Eigen::Index row = 0; row < from.rows(); ++row) to.at(row, j) = from.at(row, i);
}

Panels zero_panels(Eigen::Index rows, Eigen::Index columns) {
  Panels panels(rows);
  while (panels.columns() < columns) panels.append();
  return panels;
}

Panels panels_from(const Eigen::MatrixXd& X) {
  Panels A = zero_panels(X.rows(), X.cols());
  for_panels(A.count(), [&](Eigen::Index j) {
    const Eigen::Index first = j * kWidth, here = std::min(kWidth, X.cols() - first);
    PanelMatrix::Map(A[j], A.rows(), kWidth).leftCols(here) = X.middleCols(first, here);
  });
  return A;
}

Eigen::MatrixXd matrix_from(const Panels& A, Eigen::Index count) {
  Eigen::MatrixXd X(A.rows(), count);
  for_panels((count + kWidth - 1) / kWidth, [&](Eigen::Index j) {
    const Eigen::Index first = j * kWidth, here = std::min(kWidth, count - first);
    X.middleCols(first, here) = PanelMatrix::Map(A[j], A.rows(), kWidth).leftCols(here);
  });
  return X;
}

Eigen::MatrixXd transposed_product(const Panels& A, Eigen::Index first, Eigen::Index end, const double* W) {
  const PanelFunctions& functions = panel_functions();
  std::vector<std::vector<PanelBlock>> parts(kStripes);
  for_stripes(A.rows(), [&](Eigen::Index stripe, Eigen::Index row, Eigen::Index end_row) {
    auto& sums = parts[static_cast<std::size_t>(stripe)];
    sums.assign(static_cast<std::size_t>(end - first), PanelBlock::Zero());
    for (; row < end_row; row += kRowsAtOnce) {
      const auto rows = static_cast<std::size_t>(std::min(kRowsAtOnce, end_row - row));
      for (Eigen::Index j = first; j < end; ++j) {
        functions.add_gram(A[j] + row * kWidth, W + row * kWidth, rows,
                           sums[static_cast<std::size_t>(j - first)].data());
      }
    }
  });
  Eigen::MatrixXd G = Eigen::MatrixXd::Zero((end - first) * kWidth, kWidth);
  for (const auto& sums : parts) {
    for (std::size_t j = 0; j < sums.size(); ++j)
      G.middleRows(static_cast<Eigen::Index>(j) * kWidth, kWidth) += sums[j];
  }
  return G;
}

void subtract_product(const Panels& A, Eigen::Index first, Eigen::Index end, const Eigen::MatrixXd& H, double* W) {
  assert(H.rows() == (end - first) * kWidth && H.cols() == kWidth);
  const PanelFunctions& functions = panel_functions();
  const std::vector<PanelBlock> blocks = blocks_of(H, -1);
  for_stripes(A.rows(), [&](Eigen::Index, Eigen::Index row, Eigen::Index end_row) {
    for (; row < end_row; row += kRowsAtOnce) {
      const auto rows = static_cast<std::size_t>(std::min(kRowsAtOnce, end_row - row));
      for (Eigen::Index j = first; j < end; ++j) {
        const PanelBlock& block = blocks[static_cast<std::size_t>(j - first)];
        functions.add_product(A[j] + row * kWidth, block.data(), rows, W + row * kWidth);
      }
    }
  });
}

void scatter_rows(const double* from, const int* to_row, Eigen::Index rows, double* to) {
  for_stripes(rows, [&](Eigen::Index, Eigen::Index first, Eigen::Index end) {
    for (Eigen::Index i = first; i < end; ++i) std::memcpy(to + to_row[i] * kWidth, from + i * kWidth, 8 * kWidth);
  });
}

void gather_rows(const double* from, const int* from_row, Eigen::Index rows, double* to) {
  for_stripes(rows, [&](Eigen::Index, Eigen::Index first, Eigen::Index end) {
    for (Eigen::Index i = first; i < end; ++i) std::memcpy(to + i * kWidth, from + from_row[i] * kWidth, 8 * kWidth);
  });
}

void multiply_panel(double* W, Eigen::Index rows, const Eigen::MatrixXd& T) {
  const PanelFunctions& functions = panel_functions();
  const PanelBlock block = T;
  for_stripes(rows, [&](Eigen::Index, Eigen::Index first, Eigen::Index end) {
    std::vector<double> old(static_cast<std::size_t>(kRowsAtOnce * kWidth));
    for (Eigen::Index row = first; row < end; row += kRowsAtOnce) {
      const auto count = std::min(kRowsAtOnce, end - row);
      std::copy_n(W + row * kWidth, count * kWidth, old.data());
      std::fill_n(W + row * kWidth, count * kWidth, 0.0);
      functions.add_product(old.data(), block.data(), static_cast<std::size_t>(count), W + row * kWidth);
    }
  });
}

Eigen::MatrixXd panel_gram(const double* W, Eigen::Index rows) {
  const PanelFunctions& functions = panel_functions();
  std::vector<PanelBlock> parts(kStripes, PanelBlock::Zero());
  for_stripes(rows, [&](Eigen::Index stripe, Eigen::Index first, Eigen::Index end) {
    functions.add_gram(W + first * kWidth, W + first * kWidth, static_cast<std::size_t>(end - first),
                       parts[static_cast<std::size_t>(stripe)].data());
  });
  Eigen::MatrixXd G = Eigen::MatrixXd::Zero(kWidth, kWidth);
  for (const PanelBlock& part : parts) G += part;
  return G;
}

Eigen::MatrixXd gram(const Panels& A) {
  const PanelFunctions& functions = panel_functions();
  const Eigen::Index count = A.count();
  std::vector<std::vector<PanelBlock>> parts(kStripes);
  for_stripes(A.rows(), [&](Eigen::Index stripe, Eigen::Index first, Eigen::Index end) {
    auto& sums = parts[static_cast<std::size_t>(stripe)];
    sums.assign(static_cast<std::size_t>(count * count), PanelBlock::Zero());
    for (Eigen::Index row = first; row < end; row += kRowsAtOnce / 8) {
      const auto rows = static_cast<std::size_t>(std::min(kRowsAtOnce / 8, end - row));
      for (Eigen::Index i = 0; i < count; ++i) {
        for (Eigen::Index j = 0; j <= i; ++j) {
          functions.add_gram(A[i] + row * kWidth, A[j] + row * kWidth, rows,
                             sums[static_cast<std::size_t>(i * count + j)].data());
        }
      }
    }
  });
  Eigen::MatrixXd G = Eigen::MatrixXd::Zero(A.columns(), A.columns());
  for (const auto& sums : parts) {
    for (Eigen::Index i = 0; i < count; ++i) {
      for (Eigen::Index j = 0; j <= i; ++j) {
        G.block(i * kWidth, j * kWidth, kWidth, kWidth) += sums[static_cast<std::size_t>(i * count + j)];
      }
    }
  }
  G.triangularView<Eigen::StrictlyUpper>() = G.transpose();
  return G;
}

void rotate(Panels& A, const Eigen::MatrixXd& T) {
  assert(T.rows() == A.columns() && T.cols() % kWidth == 0 && T.cols() <= T.rows());
  const PanelFunctions& functions = panel_functions();
  const Eigen::Index from = A.count(), to = T.cols() / kWidth;
  std::vector<PanelBlock> blocks;
  std::vector<char> empty;
  for (Eigen::Index j = 0; j < to; ++j) {
    for (Eigen::Index i = 0; i < from; ++i) {
      blocks.push_back(T.block(i * kWidth, j * kWidth, kWidth, kWidth));
      empty.push_back(blocks.back().isZero(0));
    }
  }
  constexpr Eigen::Index kRows = kRowsAtOnce / 8;
  for_stripes(A.rows(), [&](Eigen::Index, Eigen::Index first, Eigen::Index end) {
    std::vector<double> result(static_cast<std::size_t>(to * kRows * kWidth));
    for (Eigen::Index row = first; row < end; row += kRows) {
      const Eigen::Index rows = std::min(kRows, end - row);
      std::fill(result.begin(), result.end(), 0.0);
      for (Eigen::Index j = 0; j < to; ++j) {
        for (Eigen::Index i = 0; i < from; ++i) {
          const auto block = static_cast<std::size_t>(j * from + i);
          if (empty[block]) continue;
          functions.add_product(A[i] + row * kWidth, blocks[block].data(), static_cast<std::size_t>(rows),
                                result.data() + j * kRows * kWidth);
        }
      }
      for (Eigen::Index j = 0; j < to; ++j) {
        std::copy_n(result.data() + j * kRows * kWidth, rows * kWidth, A[j] + row * kWidth);
      }
    }
  });
  A.drop_from(to);
}

bool orthonormalise(Panels& H, Eigen::Index m) {
  const Eigen::MatrixXd G = gram(H).topLeftCorner(m, m);
  const Eigen::LLT<Eigen::MatrixXd> cholesky(G);
  if (cholesky.info() != Eigen::Success) return false;
  Eigen::MatrixXd T = Eigen::MatrixXd::Zero(H.columns(), H.columns());
  T.topLeftCorner(m, m) = cholesky.matrixU().solve(Eigen::MatrixXd::Identity(m, m));
  rotate(H, T);
  return true;
}

}  // namespace eigencast
