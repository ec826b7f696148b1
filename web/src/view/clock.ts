// SPDX-License-Identifier: MIT

/** Microseconds on the clock that the worker shares. */
export const nowUs = (): number => Math.round((performance.timeOrigin + performance.now()) * 1000);
