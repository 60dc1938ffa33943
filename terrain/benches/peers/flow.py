#!/usr/bin/env python3
"""Filling and draining an elevation model: weald, TopoToolbox and pyflwdir on one raster.

Usage: flow.py --venv FOLDER [--weald PROGRAM] [--side CELLS] [--repeat N]

Installs numpy, rasterio, topotoolbox and pyflwdir (with numba) into FOLDER. The raster is spectral
noise (power ~ k^-3.5, range 1500 m, 10 m cells), written as a GeoTIFF that weald reads. Times are
those of the kernels alone, without reading or writing, on one thread; runs are interleaved.

The filled surface is unique, so wherever a peer's heights are heights of the raster it must equal
ours bit by bit (pyflwdir adds differences to cells and so rounds them). Drained areas depend on how
level ground is crossed and are only shown. TopoToolbox's accumulation needs its route, which fills
once more and sorts the cells: the sums that compare are in the second table.
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
        print(f"{name:<34}{cpu:>10.4f}{wall:>10.4f}{cpu / median[ours][1]:>16.2f}")
    print()


def noise(side):
    import numpy as np

    rng = np.random.default_rng(7)
    k = np.hypot(np.fft.fftfreq(side)[:, None], np.fft.rfftfreq(side)[None, :])
    k[0, 0] = 1
    spectrum = rng.normal(size=k.shape) + 1j * rng.normal(size=k.shape)
    z = np.fft.irfft2(spectrum * k ** (-3.5 / 2), (side, side))
    return ((z - z.min()) / np.ptp(z) * 1500).astype("float32")


def write_scene(folder, z):
    import rasterio

    rows, columns = z.shape
    transform = rasterio.transform.from_origin(0, rows * 10, 10, 10)
    path = os.path.join(folder, "noise.tif")
    with rasterio.open(path, "w", driver="GTiff", width=columns, height=rows, count=1,
                       dtype="float32", crs="EPSG:32613", transform=transform) as file:
        file.write(z, 1)
    with open(os.path.join(folder, "scene.toml"), "w") as file:
        file.write('seed = 1\n[terrain]\nsource = "noise.tif"\n[render]\nview = "in"\n'
                   '[[view]]\nname = "in"\nstand_at = [9, 9]\nlook_at = [50, 50]\n')
    return path


def filled_by_weald(program, folder):
    import rasterio

    weald(program, "terrain", folder, "-o", os.path.join(folder, "out"))
    with rasterio.open(os.path.join(folder, "out", "filled.tif")) as file:
        return file.read(1)


def ours(program, path, times):
    report = weald(program, "bench", "--only", "terrain", "--input", path, "--repeat", 1, "--threads", 1)
    figures = {figure["name"]: figure for figure in report["figures"]}
    for name in ("fill", "D8 and accumulation"):
        figure = figures[name]
        times.setdefault(f"weald {name}", []).append((figure["seconds"], figure["cpu_seconds"]))
    parts = [figures["fill"], figures["D8 and accumulation"]]
    whole = tuple(sum(part[key] for part in parts) for key in ("seconds", "cpu_seconds"))
    times.setdefault("weald, whole", []).append(whole)
    return figures["D8 and accumulation"]["result"]


def topotoolbox_runs(z, times):
    import topotoolbox

    grid = topotoolbox.GridObject()
    grid.z, grid.cellsize = z, 10.0
    fill, *fill_time = timed(grid.fillsinks)
    flow, *route_time = timed(lambda: topotoolbox.FlowObject(grid))
    area, *area_time = timed(flow.flow_accumulation)
    times.setdefault("TopoToolbox fill", []).append(fill_time)
    times.setdefault("TopoToolbox fill, route", []).append(route_time)
    times.setdefault("TopoToolbox accumulation", []).append(area_time)
    whole = [a + b for a, b in zip(route_time, area_time)]
    times.setdefault("TopoToolbox, whole", []).append(whole)
    return fill.z, float(area.z.max())


def pyflwdir_runs(z, times):
    import pyflwdir

    run = lambda part: pyflwdir.dem.fill_depressions(part, outlets="edge", nodata=-9999.0)
    drain = lambda d8: pyflwdir.from_array(d8, ftype="d8", check_ftype=False).upstream_area()
    if "pyflwdir, whole" not in times:
        drain(run(z[:64, :64])[1])  # numba compiles on the first call
    (fill, d8), *fill_time = timed(lambda: run(z))
    area, *area_time = timed(lambda: drain(d8))
    times.setdefault("pyflwdir fill, route", []).append(fill_time)
    times.setdefault("pyflwdir accumulation", []).append(area_time)
    times.setdefault("pyflwdir, whole", []).append([a + b for a, b in zip(fill_time, area_time)])
    return fill, float(area.max())


def compare(arguments, folder):
    import numpy as np

    z = noise(arguments.side)
    path = write_scene(folder, z)
    peers = {"TopoToolbox": ("topotoolbox", topotoolbox_runs), "pyflwdir": ("pyflwdir", pyflwdir_runs)}
    times, found, largest = {}, {}, 0.0
    for _ in range(arguments.repeat):
        largest = ours(arguments.weald, path, times)
        for name, (module, run) in peers.items():
            if present(module):
                found[name] = run(z, times)
    print(f"{arguments.side} x {arguments.side} cells, medians of {arguments.repeat}, one thread")
    show({name: runs for name, runs in times.items() if "whole" not in name}, "weald fill")
    show({name: runs for name, runs in times.items() if "whole" in name}, "weald, whole")
    filled = filled_by_weald(arguments.weald, folder)
    # Water spills at the height of some cell, so an exact filling has no other heights.
    is_exact = lambda fill: bool(np.isin(fill, z).all())
    agrees = is_exact(filled)
    print(f"heights that ours fills to are heights of the raster: {agrees}")
    for name, (fill, area) in found.items():
        apart = np.abs(fill - filled)
        print(f"filled by {name}: {np.count_nonzero(apart)} of {fill.size} cells differ, by at most "
              f"{apart.max():.2g} m; heights are the raster's: {is_exact(fill)}; "
              f"largest drained area {area:.0f}, ours {largest:.0f}")
        agrees &= not is_exact(fill) or apart.max() == 0
    return agrees


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--venv", required=True, help="folder of the virtual environment")
    parser.add_argument("--weald", default="target/release/weald")
    parser.add_argument("--side", type=int, default=1024, help="cells along a side")
    parser.add_argument("--repeat", type=int, default=3)
    arguments = parser.parse_args()
    enter(arguments.venv, {"numpy": "numpy", "rasterio": "rasterio",
                           "topotoolbox": "topotoolbox", "pyflwdir": "pyflwdir"})
    if not (present("numpy") and present("rasterio")):
        sys.exit("numpy and rasterio are needed to make the raster")
    with tempfile.TemporaryDirectory() as folder:
        sys.exit(0 if compare(arguments, folder) else 1)


if __name__ == "__main__":
    main()
