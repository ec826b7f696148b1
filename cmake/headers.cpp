// SPDX-License-Identifier: MIT
// Exists so that a target can hold precompiled headers and nothing else.
