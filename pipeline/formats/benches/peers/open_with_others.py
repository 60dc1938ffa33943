#!/usr/bin/env python3
"""Opens a folder that weald wrote with programs that others wrote.

    pip install rasterio pyarrow pandas geopandas duckdb pygltflib trimesh OpenEXR OpenImageIO pillow
    python open_with_others.py out/pond

Each file is opened with every program that knows its kind; a line says what was seen. What is not
installed is skipped and said. Exit status 1 when a program refuses a file or sees something wrong.
"""

import json
import math
import pathlib
import sys

failures = 0
missing = set()


def check(path, program, see):
    """Runs `see`, which returns a short text or raises, and reports."""
    global failures
    try:
        print(f"OK    {path.name:24} {program:12} {see()}")
    except ImportError as error:
        missing.add(error.name or str(error))
        print(f"SKIP  {path.name:24} {program:12} {error}")
    except Exception as error:
        failures += 1
        print(f"FAIL  {path.name:24} {program:12} {type(error).__name__}: {error}")


def expect(truth, what):
    if not truth:
        raise AssertionError(what)


def stage_of(text):
    return json.loads(text)["stage"]


def with_rasterio(path):
    import rasterio

    with rasterio.open(path) as raster:
        values = raster.read(1)
        expect(raster.profile["dtype"] == "float32", "not float32")
        expect(raster.profile["tiled"] and raster.block_shapes == [(256, 256)], "not tiled by 256")
        expect(raster.transform.b == 0 and raster.transform.e == -raster.transform.a, "not north-up")
        stage = stage_of(raster.tags()["weald"])
        unit, name = raster.units[0], raster.descriptions[0]
        return f"{values.shape} {name} in {unit}, {raster.crs}, {raster.bounds.left:.1f}.. from {stage}"


def with_pandas(path):
    import pandas

    table = pandas.read_parquet(path) if path.suffix == ".parquet" else pandas.read_csv(path)
    return f"{len(table)} rows, {', '.join(table.columns[:5])} …"


def with_pyarrow(path):
    import pyarrow.parquet

    file = pyarrow.parquet.ParquetFile(path)
    metadata = file.schema_arrow.metadata
    file.read()
    return f"{file.metadata.num_rows} rows from {stage_of(metadata[b'weald'])}"


def with_duckdb(path):
    import duckdb

    reader = "read_parquet" if path.suffix == ".parquet" else "read_csv"
    relation = duckdb.sql(f"select count(*), min(x), max(x) from {reader}('{path}')")
    [(count, low, high)] = relation.fetchall()
    return f"{count} rows, x in {low:.1f}..{high:.1f}"


def with_geopandas(path):
    import geopandas

    points = geopandas.read_parquet(path)
    expect((points.geometry.x == points["x"]).all(), "geometry and x differ")
    expect((points.geometry.y == points["y"]).all(), "geometry and y differ")
    code = points.crs.to_epsg() if points.crs else None
    return f"{len(points)} points, {points.crs.name if points.crs else 'no CRS'} (EPSG {code})"


def with_companion(path):
    beside = json.loads(pathlib.Path(f"{path}.json").read_text())
    return f"from {beside['weald']['stage']}"


def with_tomllib(path):
    import tomllib

    palette = tomllib.loads(path.read_text())
    stage = stage_of(palette["provenance"]["json"])
    plants, groups = palette.get("representative", []), palette.get("group", [])
    return f"{len(plants)} representatives, {len(groups)} groups from {stage}"


def with_pygltflib(path):
    import pygltflib

    gltf = pygltflib.GLTF2().load(str(path))
    expect(not gltf.extensionsRequired, "extensions are required")
    stage = gltf.asset.extras["weald"]["stage"]
    return f"{len(gltf.meshes)} meshes, {gltf.extensionsUsed} from {stage}"


def with_trimesh(path):
    import trimesh

    scene = trimesh.load(path, force="scene")
    low, high = scene.bounds
    expect(high[1] - low[1] >= 0 and all(map(math.isfinite, [*low, *high])), "no bounds")
    return f"{len(scene.geometry)} geometries, height (Y) {low[1]:.2f}..{high[1]:.2f}"


def with_openexr(path):
    import OpenEXR

    with OpenEXR.File(str(path), separate_channels=True) as file:
        kinds = {name: channel.pixels.dtype.name for name, channel in file.channels().items()}
        header = file.header()
        expect(kinds.get("Z", "float32") == "float32", "Z is not float")
        expect(kinds.get("R", "float16") == "float16", "R is not half")
        return f"{len(kinds)} channels {' '.join(sorted(kinds)[:6])} … from {stage_of(header['weald'])}"


def with_openimageio(path):
    import OpenImageIO

    image = OpenImageIO.ImageInput.open(str(path))
    spec = image.spec()
    return f"{spec.width}x{spec.height}, {spec.nchannels} channels, {spec['compression']}"


def with_pillow(path):
    from PIL import Image

    with Image.open(path) as image:
        image.load()
        return f"{image.size} {image.mode} from {stage_of(image.text['weald'])}"


def programs_for(path):
    if path.suffix == ".tif":
        return [("rasterio", with_rasterio)]
    if path.suffix == ".parquet":
        programs = [("pyarrow", with_pyarrow), ("pandas", with_pandas)]
        if path.stem.startswith("population"):
            programs += [("duckdb", with_duckdb), ("geopandas", with_geopandas)]
        return programs
    if path.suffix == ".csv":
        return [("pandas", with_pandas), ("companion", with_companion)]
    return {
        ".toml": [("tomllib", with_tomllib)],
        ".glb": [("pygltflib", with_pygltflib), ("trimesh", with_trimesh)],
        ".exr": [("OpenEXR", with_openexr), ("OpenImageIO", with_openimageio)],
        ".png": [("Pillow", with_pillow)],
    }.get(path.suffix, [])


def main():
    folder = pathlib.Path(sys.argv[1] if len(sys.argv) > 1 else ".")
    paths = sorted(path for path in folder.rglob("*") if path.is_file())
    for path in paths:
        for program, see in programs_for(path):
            check(path, program, lambda: see(path))
    if missing:
        print(f"not installed: {', '.join(sorted(missing))}")
    print(f"{failures} failures in {len(paths)} files")
    return 1 if failures or not paths else 0


if __name__ == "__main__":
    sys.exit(main())
