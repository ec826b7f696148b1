// SPDX-License-Identifier: MIT
// Reads, from standard input, the output of hdr_log_sample.cpp with hdr-histogram-js and compares what it finds with what was promised.
const fs = require('fs');
const hdr = require('hdr-histogram-js');

const lines = fs.readFileSync(0, 'utf8').trim().split('\n');
const promised = lines.filter(line => /^(key|synthetic) /.test(line)).map(line => line.split(' '));
const rows = lines.filter(line => line.startsWith('Tag='));
if (promised.length !== 3 || rows.length !== 3) throw new Error('the sample is not as expected');
rows.forEach((row, i) => {
  const fields = row.split(',');
  const tag = fields[0].slice('Tag='.length);
  const histogram = hdr.decodeFromCompressedBase64(fields[4]);
  const found = [tag, histogram.totalCount, histogram.getValueAtPercentile(50), histogram.getValueAtPercentile(99), histogram.maxValue];
  // The library rounds its maximum up to the end of its bucket: within three digits.
  const same = found.every((value, k) => k === 0 ? value === promised[i][k]
                                                 : Math.abs(value - Number(promised[i][k])) <= 1e-3 * Number(promised[i][k]));
  console.log(found.join(' '), same ? 'as written' : 'but written was ' + promised[i].join(' '));
  if (!same) process.exit(1);
});
