#!/usr/bin/env python3
"""Pictures of one scene by weald and, through `weald export --to mitsuba`, by Mitsuba 3.

Usage: mitsuba_export.py --venv FOLDER [--weald PROGRAM] [--scenes NAME ...] [--samples N] [--runs N]
                         [--keep FOLDER]

Installs numpy and mitsuba into FOLDER. Three scenes are made and rendered by both, each RUNS times
with different chance: `matt` (thin matt leaves and walls, where both materials mean the same),
`coated` (the same leaves with a glossy coat, which Mitsuba blends from its own parts) and `plants`
(aspen, coneflowers and grass by a lake, with textures and cut-outs; variation and haze off).

Told are the ratio of the mean pictures with its standard error, and a test of every 4 x 4 pixels: with
z = (ours - theirs) / sqrt(variance of both), estimated from the runs, equal pictures have a z
above 3 in about 0.5 % of the blocks (Student's t). Exit code 1 when a mean of `matt` differs by more than
0.5 %, or more than 1.5 % of its blocks by more than 3.
"""

import argparse
import importlib.util
import json
import math
import os
import struct
import subprocess
import sys
import tempfile
import venv

PACKAGES = ["numpy", "mitsuba"]
SIZE = (192, 108)
BLOCK = 4
TOLERANCE = 0.005
SUSPICIOUS = 0.015

SCENE = """
seed = 3
[terrain]
source = "ground.asc"
{terrain}
{steps}
[quantize]
representatives = 2
group_representatives = 1
group_variants = 2
[[view]]
name = "eye"
stand_at = {eye}
look_at = [32, 32]
look_height = {look_height}
fov_deg = 55
[sky]
sun_azimuth_deg = 250
sun_elevation_deg = 40
haze = 0
[render]
view = "eye"
resolution = [{width}, {height}]
bounces = 5
"""

SINGLE = """
[[ecosim.step]]
kind = "place"
species = "globe"
at = [[28, 30], [33, 26], [36, 34], [30, 38], [24, 24], [40, 29]]
age = [9, 11]
"""

WILD = """
[[ecosim.step]]
kind = "simulate"
species = ["aspen"]
years = 14
initial = 60
[[ecosim.step]]
kind = "halftone"
species = "coneflower"
formula = "if(x > 34, 1, 0)"
per_m2 = 0.3
[[ecosim.step]]
kind = "halftone"
species = "meadow"
arrange = "grid"
formula = "if(x > 18 and x < 46 and y < 16, 1, 0)"
"""

LAKE = """
[[terrain.op]]
op = "lake"
at = [32.0, 32.0]
level = 9.2
"""

GLOBE = """
[size]
height = 4.0
rate = 0.3
crown_radius = 1.6
lifespan = 60.0
[form]
generator = "model"
file = "globe.glb"
"""


def enter(folder):
    """Goes on in the virtual environment `folder`, made and filled when it is not there."""
    python = os.path.join(os.path.abspath(folder), "bin", "python")
    if not os.path.exists(python):
        venv.create(folder, with_pip=True)
    if os.path.abspath(sys.prefix) != os.path.abspath(folder):
        os.execv(python, [python, *sys.argv])
    for package in PACKAGES:
        if importlib.util.find_spec(package) is None:
            subprocess.run([python, "-m", "pip", "install", "--quiet", package])
    importlib.invalidate_caches()
    absent = [package for package in PACKAGES if importlib.util.find_spec(package) is None]
    if absent:
        sys.exit(f"needed for this comparison and absent: {', '.join(absent)}")


def globe():
    """A trunk of four sides and a globe of 1,500 leaves: vertices and triangles of each."""
    import numpy as np

    rng = np.random.default_rng(7)
    leaves = 1500
    way = rng.normal(size=(leaves, 3))
    way *= rng.random((leaves, 1)) ** (1 / 3) / np.linalg.norm(way, axis=1, keepdims=True)
    middle = way * [1.5, 1.5, 1.5] + [0, 0, 2.4]
    a, b = rng.normal(size=(2, leaves, 3))
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    b -= a * (a * b).sum(1, keepdims=True)
    b /= np.linalg.norm(b, axis=1, keepdims=True)
    a, b = a * 0.14, b * 0.1
    quads = np.stack([middle - a - b, middle + a - b, middle + a + b, middle - a + b], 1)
    corner = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * 0.1
    trunk = np.array([[[*corner[i], 0], [*corner[i - 1], 0], [*corner[i - 1], 4], [*corner[i], 4]] for i in range(4)])
    return [split(quads) for quads in (trunk, quads)]


def split(quads):
    import numpy as np

    vertices = quads.reshape(-1, 3).astype("float32")
    first = np.arange(0, len(vertices), 4)[:, None]
    return vertices, (first + [[0, 1, 2, 0, 2, 3]]).reshape(-1, 3).astype("uint32")


def write_glb(path, roughness):
    """Bark and leaves, turned to glTF's axes (Y up)."""
    import numpy as np

    data, views, accessors, primitives = b"", [], [], []
    for material, (vertices, triangles) in enumerate(globe()):
        turned = np.ascontiguousarray(np.stack([vertices[:, 0], vertices[:, 2], -vertices[:, 1]], 1))
        for array, kind, component in ((turned, "VEC3", 5126), (triangles, "SCALAR", 5125)):
            views.append({"buffer": 0, "byteOffset": len(data), "byteLength": array.nbytes})
            accessors.append({"bufferView": len(views) - 1, "componentType": component, "type": kind,
                              "count": len(array) if kind == "VEC3" else array.size})
            if kind == "VEC3":
                accessors[-1].update(min=array.min(0).tolist(), max=array.max(0).tolist())
            data += array.tobytes()
        primitives.append({"attributes": {"POSITION": len(accessors) - 2}, "indices": len(accessors) - 1,
                           "material": material})
    factor = lambda rgb, rough: {"baseColorFactor": [*rgb, 1], "roughnessFactor": rough, "metallicFactor": 0}
    through = {"KHR_materials_diffuse_transmission": {"diffuseTransmissionFactor": 0.5,
                                                      "diffuseTransmissionColorFactor": [0.3, 0.5, 0.1]}}
    document = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "extensionsUsed": list(through), "meshes": [{"primitives": primitives}],
        "materials": [{"name": "bark", "pbrMetallicRoughness": factor([0.4, 0.3, 0.2], 1)},
                      {"name": "leaf", "pbrMetallicRoughness": factor([0.3, 0.5, 0.1], roughness),
                       "extensions": through}],
        "buffers": [{"byteLength": len(data)}], "bufferViews": views, "accessors": accessors,
    }
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    with open(path, "wb") as file:
        file.write(struct.pack("<III", 0x46546C67, 2, 28 + len(text) + len(data)))
        file.write(struct.pack("<II", len(text), 0x4E4F534A) + text)
        file.write(struct.pack("<II", len(data), 0x004E4942) + data)


def write_scene(folder, name):
    os.makedirs(os.path.join(folder, "species"))
    is_wild = name == "plants"
    bowl = lambda x, y: 10 + 0.01 * y - 2 * math.exp(-((x - 32) ** 2 + (y - 32) ** 2) / 200)
    rows = [" ".join(f"{bowl(x + 0.5, 63.5 - y) if is_wild else 10:.3f}" for x in range(64)) for y in range(64)]
    with open(os.path.join(folder, "ground.asc"), "w") as file:
        file.write("ncols 64\nnrows 64\nxllcorner 0\nyllcorner 0\ncellsize 1\n" + "\n".join(rows) + "\n")
    if not is_wild:
        with open(os.path.join(folder, "species", "globe.toml"), "w") as file:
            file.write(GLOBE)
        write_glb(os.path.join(folder, "species", "globe.glb"), 1.0 if name == "matt" else 0.5)
    with open(os.path.join(folder, "scene.toml"), "w") as file:
        file.write(SCENE.format(terrain=LAKE if is_wild else "", steps=WILD if is_wild else SINGLE,
                                eye=[25.0, 2.0] if is_wild else [32.0, 16.0],
                                look_height=1.0 if is_wild else 1.8, width=SIZE[0], height=SIZE[1]))


def weald(program, *arguments):
    try:
        answer = subprocess.run([program, *map(str, arguments), "-q"], capture_output=True, text=True)
    except OSError as error:
        sys.exit(f"{program}: {error.strerror}; build it with `cargo build --release -p weald-cli`")
    if answer.returncode:
        sys.exit(f"{program} {' '.join(map(str, arguments))}\n{answer.stderr}")


def channels(path):
    import mitsuba as mi
    import numpy as np

    picture = mi.Bitmap(path)
    names = [field.name for field in picture.struct_()]
    values = np.array(picture, "float64")
    return {name: values[..., index] for index, name in enumerate(names)}


def blocks(picture):
    height, width = picture.shape[:2]
    return picture.reshape(height // BLOCK, BLOCK, width // BLOCK, BLOCK, 3).mean((1, 3))


def compare(arguments, name):
    import mitsuba as mi
    import numpy as np

    with tempfile.TemporaryDirectory() as folder:
        path = lambda *parts: os.path.join(folder, *parts)
        write_scene(path("scene"), name)
        even = ["--set", "render.variation=0"]
        weald(arguments.weald, "run", path("scene"), "-o", path("out"), "--set", "render.samples=1",
              "--set", "render.resolution=[16,9]")
        weald(arguments.weald, "export", path("scene"), "--to", "mitsuba", "--from", path("out"),
              "-o", path("mitsuba"), *even)
        theirs = mi.load_file(path("mitsuba", "scene.xml"))
        pictures = {"weald": [], "mitsuba": []}
        for seed in range(arguments.runs):
            weald(arguments.weald, "render", path("scene"), "--from", path("out"), "-o", path("ours.exr"),
                  "--samples", arguments.samples, "--seed", seed, *even)
            found = channels(path("ours.exr"))
            pictures["weald"].append(np.stack([found[part] for part in "RGB"], -1))
            picture = np.array(mi.render(theirs, spp=arguments.samples, seed=seed), "float64")
            pictures["mitsuba"].append(picture[..., :3])
    return judge(arguments, name, {key: np.stack(value) for key, value in pictures.items()})


def judge(arguments, name, pictures):
    import numpy as np

    runs = arguments.runs
    means = {key: value.mean((1, 2)) for key, value in pictures.items()}
    ours, theirs = means["weald"], means["mitsuba"]
    ratio = ours.mean(0) / theirs.mean(0)
    error = np.sqrt((ours.var(0, ddof=1) / ours.mean(0) ** 2 + theirs.var(0, ddof=1) / theirs.mean(0) ** 2) / runs)
    parts = {key: np.stack([blocks(picture) for picture in value]) for key, value in pictures.items()}
    difference = parts["weald"].mean(0) - parts["mitsuba"].mean(0)
    spread = sum(value.var(0, ddof=1) / runs for value in parts.values())
    # Half floats of the file round by 0.05 %.
    spread += (3e-4 * parts["mitsuba"].mean(0)) ** 2
    z = difference / np.sqrt(spread)
    far = (np.abs(z) > 3).mean()
    tell = lambda values: ", ".join(f"{value:.4f}" for value in values)
    print(f"{name:<8} means, ours over theirs: {tell(ratio)} (± {tell(error)}); "
          f"blocks with |z| > 3: {100 * far:.2f} %, root mean square of z: {math.sqrt((z**2).mean()):.2f}")
    if arguments.keep:
        keep(arguments.keep, name, pictures, z)
    return name != "matt" or (np.abs(ratio - 1).max() <= TOLERANCE and far <= SUSPICIOUS)


def keep(folder, name, pictures, z):
    import mitsuba as mi
    import numpy as np

    os.makedirs(folder, exist_ok=True)
    scale = 0.6 / np.percentile(pictures["weald"].mean(0), 90)
    shown = {key: value.mean(0) * scale for key, value in pictures.items()}
    far = np.kron(np.clip(z / 10, -1, 1), np.ones((BLOCK, BLOCK, 1)))
    shown["z"] = 0.5 + 0.5 * far
    for key, image in shown.items():
        mi.Bitmap(image.astype("float32")).convert(
            mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.UInt8, True).write(os.path.join(folder, f"{name}-{key}.png"))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--venv", required=True, help="folder of the virtual environment")
    parser.add_argument("--weald", default="target/release/weald")
    parser.add_argument("--scenes", nargs="+", default=["matt", "coated", "plants"], choices=["matt", "coated", "plants"])
    parser.add_argument("--samples", type=int, default=16)
    parser.add_argument("--runs", type=int, default=12)
    parser.add_argument("--keep", metavar="FOLDER", help="keep both pictures and their difference there, as PNG")
    arguments = parser.parse_args()
    enter(arguments.venv)
    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    sys.exit(0 if all([compare(arguments, name) for name in arguments.scenes]) else 1)


if __name__ == "__main__":
    main()
