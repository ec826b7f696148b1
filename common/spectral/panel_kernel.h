// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>

#include "common/core/machine.h"

namespace eigencast {

inline constexpr std::size_t kPanelWidth = 8;  ///< Columns of a panel: a cache line of doubles in each row.

/// The strict lower triangle of a unit triangular matrix, column after column.
struct UnitLower {
  const int* begin;  ///< One for each column, and the end of the last.
  const int* row;
  const double* value;
};

/// A sparse matrix, row after row.
struct SparseRows {
  const int* begin;  ///< One for each row, and the end of the last.
  const int* column;
  const double* value;
};

/// Products of panels, rows x kPanelWidth, row-major, as one instruction set does them. Small matrices are kPanelWidth
/// x kPanelWidth, row-major.
struct PanelFunctions {
  void (*add_gram)(const double* A, const double* B, std::size_t rows, double* G);     ///< G += A^T B
  void (*add_product)(const double* A, const double* H, std::size_t rows, double* W);  ///< W += A H
  /// Solve with columns [first, end) of L and of its transpose, in place on a panel.
  void (*solve_lower)(const UnitLower& L, std::size_t first, std::size_t end, double* X);
  void (*solve_upper)(const UnitLower& L, std::size_t first, std::size_t end, double* X);
  /// Rows [first, end) of Y = S X - X diag(shift), shift of kPanelWidth.
  void (*multiply)(const SparseRows& S, std::size_t first, std::size_t end, const double* X, const double* shift,
                   double* Y);
};

/// Functions of this processor's best instruction set, or of `set`, one of instruction_sets().
const PanelFunctions& panel_functions();
const PanelFunctions& panel_functions(InstructionSet set);

}  // namespace eigencast
