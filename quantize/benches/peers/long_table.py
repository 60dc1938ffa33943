#!/usr/bin/env python3
"""Writes a long Parquet table of plants, for measuring `weald quantize --table` on it.

Usage: long_table.py ROWS FILE, with numpy and pyarrow installed:

    long_table.py 1e8 long.parquet
    /usr/bin/time -v weald quantize --table long.parquet --weight weight -k 64 --json

Three measures of plants of six species whose ages are log-normal, and weights of a perspective
view, all of 32 bits; row groups of 2^20 rows. A hundred million rows take 1.6 GB.
"""

import sys

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

GROUP = 1 << 20
COLUMNS = ("maturity", "vigor", "stature", "weight")


def plants(chance, rows):
    species = chance.integers(0, 6, rows)
    age = np.exp(chance.normal(0, 0.6, rows) + 0.25 * (species - 2.5))
    vigor = chance.beta(2 + species % 3, 3, rows)
    height = age**0.7 * (0.5 + vigor) * np.exp(chance.normal(0, 0.1, rows))
    weight = 1 / np.maximum(0.03, chance.random(rows)) ** 2
    return [column.astype("f4") for column in (age / 6, vigor, height / 5, weight)]


def main():
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    rows, path = int(float(sys.argv[1])), sys.argv[2]
    chance = np.random.default_rng(1)
    schema = pa.schema([(name, pa.float32()) for name in COLUMNS])
    with pq.ParquetWriter(path, schema, compression="zstd") as out:
        for start in range(0, rows, GROUP):
            columns = plants(chance, min(GROUP, rows - start))
            out.write_table(pa.table(columns, schema=schema))


if __name__ == "__main__":
    main()
