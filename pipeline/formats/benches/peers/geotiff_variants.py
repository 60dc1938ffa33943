#!/usr/bin/env python3
"""GeoTIFFs as GDAL writes them: every type of sample in every encoding, read by weald and by rasterio.

Usage: geotiff_variants.py --venv FOLDER [--weald PROGRAM] [MODEL ...]

Installs numpy and rasterio into FOLDER. Each variant holds the same heights and a hole; `weald terrain`
writes the ground back, and its values, map and hole must be those that rasterio reads from the variant.
Each MODEL (a GeoTIFF in metres) must come back with its own map and values, too. Ends with 1 if one
does not.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import venv

TYPES = ["uint8", "int8", "uint16", "int16", "uint32", "int32", "uint64", "int64", "float32", "float64"]
ENCODINGS = {
    "plain": {},
    "packbits": {"compress": "packbits"},
    "lzw": {"compress": "lzw"},
    "lzw, predicted": {"compress": "lzw", "predictor": 2},
    "deflate, tiled": {"compress": "deflate", "tiled": True, "blockxsize": 32, "blockysize": 16},
    "deflate, float predictor": {"compress": "deflate", "predictor": 3},
    "zstd": {"compress": "zstd"},
    "big": {"BIGTIFF": "YES", "compress": "lzw"},
    "big-endian": {"ENDIANNESS": "BIG"},
    "lerc": {"compress": "lerc", "MAX_Z_ERROR": 0},
    "cloud-optimised": {"driver": "COG", "compress": "deflate", "BLOCKSIZE": 64},
    "cloud-optimised lerc": {"driver": "COG", "compress": "lerc", "MAX_Z_ERROR": 0, "BLOCKSIZE": 64},
}
HOLE = 77


def enter(folder):
    python = os.path.join(os.path.abspath(folder), "bin", "python")
    if not os.path.exists(python):
        venv.create(folder, with_pip=True)
        subprocess.run([python, "-m", "pip", "install", "--quiet", "numpy", "rasterio"], check=True)
    if os.path.abspath(sys.prefix) != os.path.abspath(folder):
        os.execv(python, [python, *sys.argv])


def heights(kind):
    import numpy as np

    z = np.random.default_rng(3).integers(1, 120, (90, 130))
    z[z == HOLE] = 78
    z[40:43, 60:70] = HOLE
    fraction = 0.125 if kind.startswith("float") else 0
    return np.where(z == HOLE, z, z + fraction).astype(kind)


def write(path, kind, encoding):
    """Whether GDAL writes such a file."""
    import rasterio
    from rasterio._err import CPLE_BaseError
    from rasterio.errors import RasterioError

    z, encoding = heights(kind), dict(encoding)
    rows, columns = z.shape
    place = rasterio.transform.from_origin(471_234.5, 4_430_123.25, 2.5, 2.5)
    try:
        with rasterio.open(path, "w", width=columns, height=rows, count=1, dtype=kind, nodata=HOLE,
                           crs="EPSG:32613", transform=place, driver=encoding.pop("driver", "GTiff"),
                           **encoding) as file:
            file.write(z, 1)
    except (RasterioError, CPLE_BaseError, ValueError, TypeError):
        return False
    return True


def read(path):
    import numpy as np
    import rasterio

    with rasterio.open(path) as file:
        z = file.read(1, masked=True).astype("float32").filled(np.nan)
        return z, file.crs, file.transform


def complaint(program, folder, path):
    """What is wrong with our ground of a model; empty when nothing is."""
    import numpy as np

    stack, out = os.path.join(folder, "stack.toml"), os.path.join(folder, "out")
    with open(stack, "w") as file:
        file.write(f'[terrain]\nsource = "{os.path.abspath(path)}"\nsource_holes = "keep"\n')
    answer = subprocess.run([program, "terrain", stack, "--layers", "altitude", "-o", out],
                            capture_output=True, text=True)
    if answer.returncode:
        return answer.stderr.strip()
    (ours, crs, place), (theirs, wanted, at) = read(os.path.join(out, "altitude.tif")), read(path)
    if crs != wanted or not place.almost_equals(at, 1e-9 * abs(at.f)):
        return f"map {crs}, {place[:6]} for {wanted}, {at[:6]}"
    if not np.array_equal(ours, theirs, equal_nan=True):
        return f"{np.count_nonzero(~((ours == theirs) | (np.isnan(ours) & np.isnan(theirs))))} values differ"
    return ""


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("models", nargs="*", metavar="MODEL")
    parser.add_argument("--venv", required=True, help="folder of the virtual environment")
    parser.add_argument("--weald", default="target/release/weald")
    arguments = parser.parse_args()
    enter(arguments.venv)
    program, read_well, wrong = os.path.abspath(arguments.weald), 0, []
    with tempfile.TemporaryDirectory() as folder:
        variants = [(f"{kind}, {name}", kind, encoding) for name, encoding in ENCODINGS.items() for kind in TYPES]
        for name, kind, encoding in variants:
            path = os.path.join(folder, "variant.tif")
            if write(path, kind, encoding):
                problem = complaint(program, folder, path)
                read_well += not problem
                wrong += [f"{name}: {problem}"] if problem else []
        for path in arguments.models:
            problem = complaint(program, folder, path)
            read_well += not problem
            wrong += [f"{path}: {problem}"] if problem else []
    print("\n".join([f"{read_well} read alike, {len(wrong)} not", *wrong]))
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
