/* SPDX-License-Identifier: MIT */
#ifndef EIGENCAST_WEB_WRITER_H
#define EIGENCAST_WEB_WRITER_H

#include "web/core/core.h"

/**
 * What eigencast-writer.wasm exports, beside memory, errors and hashes of core.h, whose rules hold: a sender's end of
 * one stream's chain of keys (sdk/key_writer.h).
 */
#ifdef __cplusplus
extern "C" {
#endif

typedef struct core_writer core_writer;

/* format  as announced
   error   of quantising: area-weighted rms over the surface, surface units; > 0. Float codecs: does not count
   area    of the surface, > 0
   Errors: invalid-argument. */
core_writer* CORE(writer_make)(const core_format* format, double error, double area);
void CORE(writer_free)(core_writer* writer);
/* What `announced` says: the next frame is the first of a chain. */
void CORE(writer_begin)(core_writer* writer, uint32_t stream_id, uint32_t tag);
/* The size of the next frame, which counts as sent: its bytes are at writer_bytes.
   coefficients  rows x channels, row-major
   Errors: invalid-argument (another size, not finite, not after the last), too-large; nothing is sent then. */
int32_t CORE(writer_frame)(core_writer* writer, const double* coefficients, uint32_t count, int64_t capture_us);
const uint8_t* CORE(writer_bytes)(const core_writer* writer);

#ifdef __cplusplus
}
#endif

#endif
