// SPDX-License-Identifier: MIT
// Exists so that its target can hold the precompiled headers of all tests.
