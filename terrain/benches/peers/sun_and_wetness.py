#!/usr/bin/env python3
"""Sun behind horizons and wetness with suction: weald, GRASS r.sun and SAGA's wetness index.

Usage: sun_and_wetness.py --venv FOLDER [--weald PROGRAM] [--side CELLS] [--repeat N] [MODEL]

GRASS and SAGA must be installed (Debian: grass-core, saga); numpy and rasterio are installed into
FOLDER. MODEL is as for flow.py, without holes; without one the raster is noise like that,
of SIDE cells. Times are those of whole processes on one thread, with reading and writing; ours fill, drain
and derive the usual layers as well, which these commands always do. r.sun gets one day, the
solstice, in steps of an hour, ours the same day and twelve days of the year.

Both wetness programs are given the filled surface, since each deals with hollows in its own way. The
models of air and the rules of slope differ, so values are compared by correlation, which is printed.
What the sun's beam gives is also integrated plainly here, for some cells, by marching toward each
place of the sun. Ends with 1 if ours are below 0.98 with that, or below 0.85 with SAGA.
"""

import argparse
import os
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile

from flow import CELL, enter, layers_of_weald, noise, read_model, show, write_model

SOLSTICE = 172
MONTHS = [15 + round(30.4 * month) for month in range(12)]
LATITUDE = 40.0
# Programs treat the rim in their own ways.
INSIDE = (slice(2, -2), slice(2, -2))


def hills(side):
    """The noise of flow.py, as steep at any size as at 1024 cells."""
    return noise(side) * (side / 1024)


def timed(command, **options):
    """Wall seconds and processor seconds of a process with all that it starts."""
    import time

    used = lambda: (lambda r: r.ru_utime + r.ru_stime)(resource.getrusage(resource.RUSAGE_CHILDREN))
    wall, cpu = time.perf_counter(), used()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, **options)
    return time.perf_counter() - wall, used() - cpu


def ours(program, folder, model, layer, days):
    stack = os.path.join(folder, "stack.toml")
    with open(stack, "w") as file:
        file.write(f'[terrain]\nsource = "{model}"\n[terrain.environment]\n'
                   f"latitude_deg = {LATITUDE}\ndays = {days}\n")
    out = os.path.join(folder, "ours")
    time = timed([program, "terrain", stack, "--layers", layer, "-o", out, "--threads", "1"])
    return time, read_model(os.path.join(out, f"{layer}.tif"))


def grass(folder, model):
    """One day of r.sun with the shadows of the terrain; slope and aspect are made before."""
    out = os.path.join(folder, "sun.tif")
    script = os.path.join(folder, "sun.sh")
    with open(script, "w") as file:
        file.write(f"""set -e
r.in.gdal --quiet -o input={model} output=z
g.region raster=z
r.slope.aspect --quiet elevation=z slope=slope aspect=aspect
r.sun --quiet elevation=z slope=slope aspect=aspect day={SOLSTICE} step=1 nprocs=1 glob_rad=sun
r.out.gdal --quiet --overwrite -f input=sun output={out} format=GTiff type=Float32
""")
    time = timed(["grass", "--tmp-location", model, "--exec", "bash", script])
    return time, read_model(out)


def saga(folder, model):
    out = os.path.join(folder, "wetness.sdat")
    tool = ["saga_cmd", "--cores=1", "ta_hydrology", "15", "-DEM", model, "-SUCTION", "10",
            "-AREA_TYPE", "2", "-SLOPE_TYPE", "0", "-TWI", out.replace(".sdat", ".sgrd")]
    return timed(tool), read_model(out)


def marched(z, rows, columns, days):
    """The beam's energy on some cells, in no unit: sun by sun, step by step over the ground."""
    import numpy as np

    side = lambda dr, dc: z[rows + dr, columns + dc].astype(float)
    across = sum(w * (side(d, 1) - side(d, -1)) for d, w in ((-1, 1), (0, 2), (1, 1))) / (8 * CELL)
    up = sum(w * (side(-1, d) - side(1, d)) for d, w in ((-1, 1), (0, 2), (1, 1))) / (8 * CELL)
    normal = np.array([-across, -up, np.ones_like(up)]) / np.sqrt(across**2 + up**2 + 1)
    latitude, energy = np.radians(LATITUDE), np.zeros(len(rows))
    tilt = np.radians(23.45) * np.sin(2 * np.pi * (days + 284) / 365)
    for hour in np.radians(15 * (np.arange(96) / 4 - 11.875)):
        height = np.sin(latitude) * np.sin(tilt) + np.cos(latitude) * np.cos(tilt) * np.cos(hour)
        if height <= 0.01:
            continue
        east = -np.cos(tilt) * np.sin(hour)
        north = (np.sin(tilt) - np.sin(latitude) * height) / np.cos(latitude)
        level, is_lit = np.hypot(east, north), np.ones(len(rows), bool)
        for step in np.arange(0.7, np.ptp(z) * level / height / CELL, 0.35):
            r, c = rows - step * north / level, columns + step * east / level
            inside = (r >= 0) & (r < z.shape[0] - 1) & (c >= 0) & (c < z.shape[1] - 1)
            if not (inside & is_lit).any():
                break
            r, c = np.where(inside, r, 0), np.where(inside, c, 0)
            r0, c0 = r.astype(int), c.astype(int)
            fr, fc = r - r0, c - c0
            ground = ((z[r0, c0] * (1 - fc) + z[r0, c0 + 1] * fc) * (1 - fr)
                      + (z[r0 + 1, c0] * (1 - fc) + z[r0 + 1, c0 + 1] * fc) * fr)
            is_lit &= ~(inside & (ground > z[rows, columns] + step * CELL * height / level))
        falls = np.maximum(normal.T @ [east, north, height], 0)
        energy += falls * is_lit * 0.7 ** (1 / height)
    return energy


def correlation(a, b):
    import numpy as np

    a, b = a.ravel().astype(float), b.ravel().astype(float)
    known = np.isfinite(a) & np.isfinite(b)
    return float(np.corrcoef(a[known], b[known])[0, 1])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("model", nargs="?", metavar="MODEL")
    parser.add_argument("--venv", required=True, help="folder of the virtual environment")
    parser.add_argument("--weald", default="target/release/weald")
    parser.add_argument("--side", type=int, default=512, help="cells along a side of the noise")
    parser.add_argument("--repeat", type=int, default=1)
    arguments = parser.parse_args()
    enter(arguments.venv, {"numpy": "numpy", "rasterio": "rasterio"})
    program = os.path.abspath(arguments.weald)
    if not shutil.which(program):
        sys.exit(f"{program} is no program; build it with `cargo build --release -p weald-cli`")
    import numpy as np

    times, found, sun_of_grass, agree = {}, {}, None, True
    with tempfile.TemporaryDirectory() as folder:
        z = read_model(arguments.model) if arguments.model else hills(arguments.side)
        model = write_model(folder, z)
        filled = write_model(folder, layers_of_weald(program, folder, model)[0])
        for _ in range(arguments.repeat):
            sun, values = ours(program, folder, model, "insolation", [SOLSTICE])
            times.setdefault("sun", {}).setdefault("weald, 1 day", []).append(sun)
            months, _ = ours(program, folder, model, "insolation", MONTHS)
            times["sun"].setdefault("weald, 12 days", []).append(months)
            wet, wetness = ours(program, folder, filled, "wetness_suction", [SOLSTICE])
            times.setdefault("wetness with suction", {}).setdefault("weald", []).append(wet)
            if shutil.which("grass"):
                time, sun_of_grass = grass(folder, model)
                times["sun"].setdefault("GRASS r.sun, 1 day", []).append(time)
                found["r.sun"] = (correlation(values[INSIDE], sun_of_grass[INSIDE]), 0)
            if shutil.which("saga_cmd"):
                time, theirs = saga(folder, filled)
                times["wetness with suction"].setdefault("SAGA wetness index", []).append(time)
                found["SAGA"] = (correlation(wetness[INSIDE], theirs[INSIDE]), 0.85)
        rng = np.random.default_rng(1)
        rows, columns = (rng.integers(2, side - 2, 2000) for side in z.shape)
        plain, at = marched(z, rows, columns, SOLSTICE), (rows, columns)
        found["a plain march of ours"] = (correlation(values[at], plain), 0.98)
        if sun_of_grass is not None:
            found["a plain march of r.sun"] = (correlation(sun_of_grass[at], plain), 0)
        print(f"{z.shape[1]} x {z.shape[0]} cells, medians of {arguments.repeat}, whole processes")
        for work, reference in (("sun", "weald, 1 day"), ("wetness with suction", "weald")):
            print(f"\n{work}")
            show(times[work], reference)
        for name, (value, least) in found.items():
            print(f"correlation with {name}: {value:.4f}")
            agree &= value >= least
    sys.exit(0 if agree else 1)


if __name__ == "__main__":
    main()
