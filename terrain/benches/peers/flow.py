#!/usr/bin/env python3
"""Filling and draining elevation models: weald, TopoToolbox, pyflwdir and Whitebox Workflows.

Usage: flow.py --venv FOLDER [--weald PROGRAM] [--side CELLS] [--repeat N] [MODEL ...]

Installs numpy, rasterio, topotoolbox, pyflwdir (with numba) and whitebox-workflows into FOLDER. Each
MODEL is a raster that rasterio reads, or NPZ with an array `elevation`; its cells are taken for squares
of 10 m, whatever its map says, so that all programs see the same numbers. Without one the raster is
spectral noise (power ~ k^-3.5, range 1500 m) of SIDE cells. Times are those of the kernels alone,
without reading or writing, on one thread; runs are interleaved. Models with holes are compared, but
not timed.

Ends with 1 unless ours agrees with the peers. The filled surface is unique, so wherever a peer's
heights are heights of the raster it must equal ours bit by bit (others add differences to cells, or
slopes to level ground). The steepest way down is unique but for forks and level ground: areas of
cells whose water passes neither must be those of TopoToolbox.
"""

import argparse
import importlib.util
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
import venv


CELL = 10.0


def enter(folder, packages):
    """Goes on in the virtual environment `folder`, made and filled when it is not there."""
    python = os.path.join(os.path.abspath(folder), "bin", "python")
    if not os.path.exists(python):
        venv.create(folder, with_pip=True)
    if os.path.abspath(sys.prefix) != os.path.abspath(folder):
        os.execv(python, [python, *sys.argv])
    for package, module in packages.items():
        if importlib.util.find_spec(module) is None:
            install = [python, "-m", "pip", "install", "--quiet", package]
            if subprocess.run(install, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL).returncode:
                print(f"{package} does not install here: left out")
    importlib.invalidate_caches()


def present(module):
    return importlib.util.find_spec(module) is not None


def timed(work):
    """Result, wall seconds and processor seconds of all threads."""
    wall, cpu = time.perf_counter(), time.process_time()
    made = work()
    return made, time.perf_counter() - wall, time.process_time() - cpu


def weald(program, *arguments):
    """The JSON report of a command; an error of ours is shown and ends the comparison."""
    command = [program, *map(str, arguments), "--json"]
    try:
        answer = subprocess.run(command, capture_output=True, text=True)
    except OSError as error:
        sys.exit(f"{program}: {error.strerror}; build it with `cargo build --release -p weald-cli`")
    if answer.returncode:
        sys.exit(f"{' '.join(command)}\n{answer.stderr}")
    return json.loads(answer.stdout or "null")


def show(times, ours):
    """Medians, and how many times the processor seconds of `ours` each took."""
    median = {name: [statistics.median(part) for part in zip(*runs)] for name, runs in times.items()}
    print(f"{'':<34}{'CPU s':>10}{'wall s':>10}{'CPU, ours = 1':>16}")
    for name, (wall, cpu) in median.items():
        # A small model may take less time than the clock tells.
        ratio = f"{cpu / median[ours][1]:.2f}" if median[ours][1] else "-"
        print(f"{name:<34}{cpu:>10.4f}{wall:>10.4f}{ratio:>16}")
    print()


def noise(side):
    import numpy as np

    rng = np.random.default_rng(7)
    k = np.hypot(np.fft.fftfreq(side)[:, None], np.fft.rfftfreq(side)[None, :])
    k[0, 0] = 1
    spectrum = rng.normal(size=k.shape) + 1j * rng.normal(size=k.shape)
    z = np.fft.irfft2(spectrum * k ** (-3.5 / 2), (side, side))
    return ((z - z.min()) / np.ptp(z) * 1500).astype("float32")


def write_model(folder, z):
    import rasterio

    rows, columns = z.shape
    # On the meridian of zone 13, 40 degrees north.
    transform = rasterio.transform.from_origin(500_000, 4_427_757 + rows * CELL, CELL, CELL)
    # Whitebox remembers what it has read by its name.
    path = os.path.join(folder, f"model-{len(os.listdir(folder))}.tif")
    with rasterio.open(path, "w", driver="GTiff", width=columns, height=rows, count=1, nodata="nan",
                       dtype="float32", crs="EPSG:32613", transform=transform) as file:
        file.write(z, 1)
    return path


def read_model(path):
    """Heights of a model, NaN in its holes, north row first."""
    import numpy as np
    import rasterio

    if path.endswith(".npz"):
        return np.load(path)["elevation"].astype("float32")
    with rasterio.open(path) as file:
        return file.read(1, masked=True).astype("float32").filled(np.nan)


def layers_of_weald(program, folder, path):
    """The filled surface and the D8 areas in cells, from `weald terrain`."""
    import rasterio

    stack = os.path.join(folder, "stack.toml")
    with open(stack, "w") as file:
        file.write(f"[terrain]\nsource = {json.dumps(os.path.abspath(path))}\n"
                   "source_holes = \"keep\"\n")
    out = os.path.join(folder, "out")
    weald(program, "terrain", stack, "--layers", "filled,upslope_area", "-o", out)
    read = lambda name: rasterio.open(os.path.join(out, f"{name}.tif"))
    with read("filled") as filled, read("upslope_area") as area:
        cell = area.transform.a * -area.transform.e
        return filled.read(1), area.read(1) / cell


def add(times, work, name, parts):
    """Adds one run of a peer: the sum of some (wall, CPU) pairs."""
    total = [sum(part[key] for part in parts) for key in (0, 1)]
    times.setdefault(work, {}).setdefault(name, []).append(total)


def ours(program, path, times):
    # The better of two: the peers, too, have their first run to warm up in, being timed by medians.
    report = weald(program, "bench", "--only", "terrain", "--input", path, "--repeat", 2, "--threads", 1)
    time = {f["name"]: (f["seconds"], f["cpu_seconds"]) for f in report["figures"]}
    add(times, "fill", "weald", [time["fill, levels alone"]])
    add(times, "fill, D8", "weald", [time["fill"], time["D8 and accumulation"]])
    add(times, "D-infinity", "weald", [time["D-infinity"]])
    add(times, "multiple flow", "weald", [time["multiple flow"]])


def topotoolbox_runs(z, times):
    import topotoolbox

    grid = topotoolbox.GridObject()
    grid.z, grid.cellsize = z, CELL
    fill, *fill_time = timed(grid.fillsinks)
    flow, *route_time = timed(lambda: topotoolbox.FlowObject(grid))
    area, *area_time = timed(flow.flow_accumulation)
    add(times, "fill", "TopoToolbox", [fill_time])
    add(times, "fill, D8", "TopoToolbox (fills while it routes)", [route_time, area_time])
    grid.z = odd_ways(fill.z).astype("float32")
    return fill.z, area.z, flow.flow_accumulation(weights=grid).z == 0


def odd_ways(z):
    """Cells that more than one neighbour lies steepest below, or none, and all around them.

    Level ground has no steepest way, and each program leads water over it in its own, so that any
    of its neighbours may receive it.
    """
    import numpy as np

    # Ground that is very high takes no water: what is around the grid, and holes.
    z = np.where(np.isnan(z), 1e9, z.astype(float))
    padded = np.pad(z, 1, constant_values=1e9)
    rows, columns = z.shape
    falls = np.array([
        (z - padded[1 + dy:1 + dy + rows, 1 + dx:1 + dx + columns]) / np.hypot(dx, dy)
        for dy in (-1, 0, 1) for dx in (-1, 0, 1) if dx or dy])
    steepest = np.sort(falls, axis=0)[::-1]
    odd = (steepest[0] <= 0) | (steepest[0] - steepest[1] <= 1e-6 * np.abs(steepest[0]))
    around = np.pad(odd, 1)
    return np.any([around[dy:dy + rows, dx:dx + columns]
                   for dy in range(3) for dx in range(3)], axis=0)


def pyflwdir_runs(z, times):
    import numpy as np
    import pyflwdir

    run = lambda part: pyflwdir.dem.fill_depressions(part, outlets="edge", nodata=-9999.0)
    drain = lambda d8: pyflwdir.from_array(d8, ftype="d8", check_ftype=False).upstream_area()
    known = np.isfinite(z)
    z = np.where(known, z, np.float32(-9999))
    if "pyflwdir" not in times.get("fill, D8", {}):
        drain(run(z[:64, :64])[1])  # numba compiles on the first call
    (fill, d8), *fill_time = timed(lambda: run(z))
    _, *area_time = timed(lambda: drain(d8))
    add(times, "fill, D8", "pyflwdir", [fill_time, area_time])
    # Its ways are those of its flood, which need not be the steepest: areas are not compared.
    return np.where(known, fill, np.float32(np.nan)), None, None


def whitebox_runs(z, times):
    import numpy as np
    import whitebox_workflows

    environment = whitebox_workflows.WbEnvironment()
    environment.verbose, environment.max_procs = False, 1
    hydrology = environment.hydrology
    hollows, routing = hydrology.depressions_storage, hydrology.flow_routing
    grid = whitebox_workflows.Raster.from_numpy(z.astype("float32"), WHITEBOX["model"])
    fill, *fill_time = timed(
        lambda: hollows.fill_depressions_wang_and_liu(dem=grid, fix_flats=False))
    # Its ways of flow want level ground to fall.
    routed, *route_time = timed(lambda: hollows.fill_depressions(dem=grid))
    add(times, "fill", "Whitebox (Wang and Liu)", [fill_time])
    for work, run in (("fill, D8", lambda dem: routing.d8_flow_accum(input=dem)),
                      ("D-infinity", lambda dem: routing.dinf_flow_accum(input=dem)),
                      ("multiple flow", lambda dem: routing.fd8_flow_accum(dem=dem))):
        _, *time = timed(lambda: run(routed))
        add(times, work, "Whitebox", [route_time, time] if work == "fill, D8" else [time])
    return np.asarray(fill.to_numpy(), dtype="float32"), None, None


# Whitebox takes the georeference of an array from a raster that it read.
WHITEBOX = {}


def compare(arguments, folder, path):
    import numpy as np
    import rasterio

    z = read_model(path)
    known = np.isfinite(z)
    is_whole = bool(known.all())
    model = write_model(folder, z)
    runs = {"topotoolbox": topotoolbox_runs, "pyflwdir": pyflwdir_runs}
    if present("whitebox_workflows") and is_whole:
        import whitebox_workflows
        runs["whitebox_workflows"] = whitebox_runs
        WHITEBOX["model"] = whitebox_workflows.WbEnvironment().read_raster(model)
    times, found = {}, {}
    for _ in range(arguments.repeat):
        if is_whole:
            ours(arguments.weald, model, times)
        for module, run in runs.items():
            if present(module):
                found[module] = run(z, times)
    rows, columns = z.shape
    print(f"\n{path}: {columns} x {rows} cells, {known.size - known.sum()} of them without data; "
          f"medians of {arguments.repeat}, one thread")
    for work, runs in times.items() if is_whole else ():
        print(f"\n{work}")
        show(runs, "weald")
    filled, area = layers_of_weald(arguments.weald, folder, model)
    # Water spills at the height of some cell, so an exact filling has no other heights.
    is_exact = lambda fill: bool(np.isin(fill[known], z[known]).all())
    agrees = is_exact(filled) and bool((np.isnan(filled) == ~known).all())
    print(f"heights that ours fills to are heights of the raster: {agrees}")
    for name, (fill, peers_area, is_plain) in found.items():
        apart = np.abs(fill - filled)[known]
        print(f"filled by {name}: {np.count_nonzero(apart)} of {apart.size} cells differ, by at most "
              f"{apart.max():.2g} m; heights are the raster's: {is_exact(fill)}")
        agrees &= not is_exact(fill) or apart.max() == 0
        if peers_area is not None:
            equal = np.round(area) == np.round(peers_area)
            is_plain &= known
            print(f"areas of {name}: equal in {equal[known].mean():.1%} of all cells, and in "
                  f"{np.count_nonzero(equal & is_plain)} of the {np.count_nonzero(is_plain)} whose "
                  "water passes no level ground and no fork")
            agrees &= bool(equal[is_plain].all())
    return agrees


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("models", nargs="*", metavar="MODEL")
    parser.add_argument("--venv", required=True, help="folder of the virtual environment")
    parser.add_argument("--weald", default="target/release/weald")
    parser.add_argument("--side", type=int, default=1024, help="cells along a side of the noise")
    parser.add_argument("--repeat", type=int, default=3)
    arguments = parser.parse_args()
    enter(arguments.venv, {"numpy": "numpy", "rasterio": "rasterio", "topotoolbox": "topotoolbox",
                           "pyflwdir": "pyflwdir", "whitebox-workflows": "whitebox_workflows"})
    if not (present("numpy") and present("rasterio")):
        sys.exit("numpy and rasterio are needed to make and read rasters")
    with tempfile.TemporaryDirectory() as folder:
        models = arguments.models or [write_model(folder, noise(arguments.side))]
        agree = [compare(arguments, folder, path) for path in models]
    sys.exit(0 if all(agree) else 1)


if __name__ == "__main__":
    main()
