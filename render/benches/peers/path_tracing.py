#!/usr/bin/env python3
"""Path tracing of instanced trees: weald and Mitsuba 3 on one scene.

Usage: path_tracing.py --venv FOLDER [--weald PROGRAM] [--trees N ...] [--samples N] [--repeat N]

Installs numpy, mitsuba, rasterio, pyarrow and OpenEXR into FOLDER. N copies of one tree of 60,000
triangles stand 5 m apart on level ground, lit by sun and sky; five scattering events. Both sides
read the same mesh and the same instances. Mitsuba gets weald's own light, read off pictures that
weald makes: an environment map of the bare sky, and the sun's irradiance off open ground.
Reflectances are the averages of weald's albedo channel, since weald varies them from plant to
plant and over the ground.

CPU seconds of weald are the difference of two runs with few and many samples, so reading files and
building the scene are not in them; Mitsuba is timed around its render call. Both use all threads.
The means of the pictures must agree within 4 %: what is averaged (reflectances, the sky at the
horizon, hills beyond the terrain) leaves 1 to 3 %.
"""

import argparse
import importlib.util
import json
import math
import os
import resource
import statistics
import struct
import subprocess
import sys
import tempfile
import time
import venv

PACKAGES = {"numpy": "numpy", "rasterio": "rasterio", "pyarrow": "pyarrow", "OpenEXR": "OpenEXR",
            "mitsuba": "mitsuba"}
SIZE = (320, 180)
FOV = 60.0
BOUNCES = 5
SUN = (210.0, 40.0)  # azimuth, elevation
FACE = 256
TOLERANCE = 0.04


def enter(folder):
    """Goes on in the virtual environment `folder`, made and filled when it is not there."""
    python = os.path.join(os.path.abspath(folder), "bin", "python")
    if not os.path.exists(python):
        venv.create(folder, with_pip=True)
    if os.path.abspath(sys.prefix) != os.path.abspath(folder):
        os.execv(python, [python, *sys.argv])
    for package, module in PACKAGES.items():
        if importlib.util.find_spec(module) is None:
            install = [python, "-m", "pip", "install", "--quiet", package]
            if subprocess.run(install, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL).returncode:
                print(f"{package} does not install here")
    importlib.invalidate_caches()
    absent = [package for package, module in PACKAGES.items() if importlib.util.find_spec(module) is None]
    if absent:
        sys.exit(f"needed for this comparison and absent: {', '.join(absent)}")


def tree():
    """A trunk of four sides and a crown of 30,000 quads: vertices, triangles."""
    import numpy as np

    rng = np.random.default_rng(7)
    leaves = 30_000
    way = rng.normal(size=(leaves, 3))
    way *= rng.random((leaves, 1)) ** (1 / 3) / np.linalg.norm(way, axis=1, keepdims=True)
    middle = way * [1.8, 1.8, 3.0] + [0, 0, 5.5]
    a, b = rng.normal(size=(2, leaves, 3))
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    b -= a * (a * b).sum(1, keepdims=True)
    b /= np.linalg.norm(b, axis=1, keepdims=True)
    a, b = a * 0.06, b * 0.035
    quads = np.stack([middle - a - b, middle + a - b, middle + a + b, middle - a + b], 1)
    corner = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * 0.12
    trunk = np.array([[[*corner[i], 0], [*corner[i - 1], 0], [*corner[i - 1], 5], [*corner[i], 5]] for i in range(4)])
    vertices = np.concatenate([trunk, quads]).reshape(-1, 3).astype("float32")
    first = np.arange(0, len(vertices), 4)[:, None]
    triangles = (first + [[0, 1, 2, 0, 2, 3]]).reshape(-1, 3).astype("uint32")
    return vertices, triangles


def write_glb(path, vertices, triangles):
    """One matt mesh, turned to glTF's axes (Y up)."""
    import numpy as np

    turned = np.ascontiguousarray(np.stack([vertices[:, 0], vertices[:, 2], -vertices[:, 1]], 1))
    data = turned.tobytes() + triangles.tobytes()
    document = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.5, 0.5, 1],
                                                "roughnessFactor": 1, "metallicFactor": 0}}],
        "buffers": [{"byteLength": len(data)}],
        "bufferViews": [{"buffer": 0, "byteLength": turned.nbytes},
                        {"buffer": 0, "byteOffset": turned.nbytes, "byteLength": triangles.nbytes}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": len(turned), "type": "VEC3",
             "min": turned.min(0).tolist(), "max": turned.max(0).tolist()},
            {"bufferView": 1, "componentType": 5125, "count": triangles.size, "type": "SCALAR"}],
    }
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    with open(path, "wb") as file:
        file.write(struct.pack("<III", 0x46546C67, 2, 28 + len(text) + len(data)))
        file.write(struct.pack("<II", len(text), 0x4E4F534A) + text)
        file.write(struct.pack("<II", len(data), 0x004E4942) + data)


def places(count):
    """A jittered lattice, turned and scaled at random: x, y, angle, scale."""
    import numpy as np

    rng = np.random.default_rng(11)
    side = math.ceil(count**0.5)
    cell = np.arange(count)
    at = np.stack([cell % side, cell // side], 1) + 0.5 + 0.35 * rng.uniform(-1, 1, (count, 2))
    return 5 * at[:, 0], 5 * at[:, 1], rng.uniform(0, 2 * math.pi, count), rng.uniform(0.7, 1.3, count)


def run_weald(program, *arguments):
    """CPU seconds of a command; an error of ours is shown and ends the comparison."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    began = time.perf_counter()
    try:
        answer = subprocess.run([program, *map(str, arguments), "-q"], capture_output=True, text=True)
    except OSError as error:
        sys.exit(f"{program}: {error.strerror}; build it with `cargo build --release -p weald-cli`")
    if answer.returncode:
        sys.exit(f"{program} {' '.join(map(str, arguments))}\n{answer.stderr}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return time.perf_counter() - began, cpu


class Scene:
    """A folder that holds all files of a scene, and of the sky without trees."""

    def __init__(self, folder, program, count):
        import numpy as np

        self.folder, self.program, self.count = folder, program, count
        self.x, self.y, self.angle, self.scale = places(count)
        self.width = max(64, int(5 * math.ceil(count**0.5)) + 2)
        middle = self.width / 2
        # From the edge of the wood into it, the eye among the crowns' feet.
        self.eye = np.array([middle, 1.0, 1.7])
        self.target = np.array([middle, 41.0, 6.0])
        self.write()

    def write(self):
        import numpy as np
        import pyarrow as pa
        import pyarrow.parquet as pq
        import rasterio

        path = lambda *parts: os.path.join(self.folder, *parts)
        transform = rasterio.transform.from_origin(0, self.width, 1, 1)
        with rasterio.open(path("level.tif"), "w", driver="GTiff", width=self.width, height=self.width,
                           count=1, dtype="float32", crs="EPSG:32613", transform=transform) as file:
            file.write(np.full((self.width, self.width), 100, "float32"), 1)
        with open(path("scene.toml"), "w") as file:
            file.write(self.toml())
        run_weald(self.program, "terrain", self.folder, "-o", path("terrain"))
        os.makedirs(path("plants"))
        self.vertices, self.triangles = tree()
        write_glb(path("plants", "0001.glb"), self.vertices, self.triangles)
        with open(path("palette.toml"), "w") as file:
            file.write('[[representative]]\nid = 1\nspecies = "aspen"\nage = 20.0\nvigor = 1.0\n'
                       f"height = 8.5\nradius = 1.8\nweight = 1.0\ncount = {self.count}\n")
        n = self.count
        single = lambda values: pa.array(np.asarray(values, "float32"))
        whole = lambda values: pa.array(np.asarray(values, "uint64"))
        columns = {
            "group": whole([0] * n), "prototype": whole([1] * n), "plant_id": whole(range(n)),
            "x": pa.array(self.x), "y": pa.array(self.y), "z": pa.array([100.0] * n),
            "qx": single([0] * n), "qy": single([0] * n),
            "qz": single(np.sin(self.angle / 2)), "qw": single(np.cos(self.angle / 2)),
            "scale": single(self.scale),
        }
        schema = pa.schema([pa.field(name, column.type, nullable=False) for name, column in columns.items()])
        pq.write_table(pa.table(columns, schema=schema), path("instances.parquet"))

    def toml(self):
        import numpy as np

        middle = self.width / 2
        views = [("wood", self.eye, self.target, FOV)]
        # A cube of pictures of the sky from above all trees, and one down on open ground.
        above = self.eye + [0, 0, 60]
        for name, way in SKY_VIEWS.items():
            views.append((name, above, above + way, 90.0))
        views.append(("ground", above, np.array([middle + 8, middle + 8, 0.0]), 10.0))
        text = ('seed = 1\n[terrain]\nsource = "level.tif"\n[render]\nview = "wood"\n'
                f"resolution = [{SIZE[0]}, {SIZE[1]}]\nbounces = {BOUNCES}\n"
                f"[sky]\nsun_azimuth_deg = {SUN[0]}\nsun_elevation_deg = {SUN[1]}\nhaze = 0\n")
        for name, eye, to, fov in views:
            text += (f'[[view]]\nname = "{name}"\nstand_at = [{eye[0]}, {eye[1]}]\neye_height = {eye[2]}\n'
                     f"look_at = [{to[0]}, {to[1]}]\nlook_height = {to[2]}\nfov_deg = {fov}\n")
        return text

    def render(self, samples, view="wood", size=SIZE, bounces=BOUNCES):
        out = os.path.join(self.folder, f"{view}.exr")
        times = run_weald(self.program, "render", self.folder, "--from", self.folder, "-o", out,
                          "--set", f'render.view="{view}"', "--set", f"render.bounces={bounces}", "--set", f"render.samples={samples}",
                          "--set", f"render.resolution=[{size[0]}, {size[1]}]")
        return channels(out), *times


SKY_VIEWS = {"north": [0, 40, 0], "east": [40, 0, 0], "south": [0, -40, 0], "west": [-40, 0, 0],
             "up": [0, 0.001, 40]}


def toward_sun():
    import numpy as np

    azimuth, elevation = map(math.radians, SUN)
    return np.array([math.sin(azimuth) * math.cos(elevation), math.cos(azimuth) * math.cos(elevation),
                     math.sin(elevation)])


def channels(path):
    import OpenEXR

    file = OpenEXR.File(path, separate_channels=True)
    return {name: channel.pixels for name, channel in file.channels().items()}


def colour(picture, prefix=""):
    import numpy as np

    return np.stack([picture[f"{prefix}{part}"] for part in "RGB"], -1).astype("float64")


def sky_of(scene):
    """An environment map by azimuth clockwise from north and height, and the sun's irradiance."""
    import numpy as np

    faces = {}
    for name, way in SKY_VIEWS.items():
        forward = np.array(way) / np.linalg.norm(way)
        right = np.cross(forward, [0, 0, 1])
        right /= np.linalg.norm(right)
        picture = colour(scene.render(1, name, (FACE, FACE))[0])
        faces[name] = forward, right, np.cross(right, forward), picture
    rows, columns = 256, 512
    zenith = (np.arange(rows) + 0.5) / rows * math.pi
    azimuth = (np.arange(columns) + 0.5) / columns * 2 * math.pi
    # Hills hide the sky at the horizon: the light there is taken from 1.5 degrees above it.
    height = np.maximum(math.pi / 2 - zenith, math.radians(1.5))[:, None]
    way = lambda azimuth: np.stack([np.sin(azimuth) * np.cos(height), np.cos(azimuth) * np.cos(height),
                                    np.sin(height) + 0 * azimuth], -1)
    directions = way(azimuth[None, :])
    # The disc of the sun comes separately; what lies beside it stands for the sky there.
    is_sun = directions @ toward_sun() > math.cos(math.radians(1.5))
    directions = np.where(is_sun[..., None], way(azimuth[None, :] + math.radians(4)), directions)
    sky = np.zeros((rows, columns, 3))
    best = np.full((rows, columns), -1.0)
    for forward, right, up, picture in faces.values():
        depth = directions @ forward
        nearer = depth > best
        best = np.where(nearer, depth, best)
        at = lambda axis: np.clip((directions @ axis / np.maximum(depth, 1e-9) + 1) / 2 * FACE, 0, FACE - 1)
        seen = picture[(FACE - 1 - at(up)).round().astype(int), at(right).astype(int)]
        sky[nearer] = seen[nearer]
    sky[zenith > math.pi / 2] = 0  # the ground covers the lower half
    return sky, sun_of(scene, sky, zenith)


def sun_of(scene, sky, zenith):
    """Irradiance of the sun across its rays, from what level open ground reflects in one bounce.

    The disc itself is too bright for the half floats of a picture.
    """
    import numpy as np

    picture = scene.render(32, "ground", (64, 64), bounces=1)[0]
    from_both = math.pi * colour(picture).mean((0, 1)) / colour(picture, "albedo.").mean((0, 1))
    solid_angle = (math.pi / len(zenith)) * (2 * math.pi / sky.shape[1]) * np.sin(zenith)
    from_sky = (sky * (solid_angle * np.maximum(np.cos(zenith), 0))[:, None, None]).sum((0, 1))
    return (from_both - from_sky) / toward_sun()[2]


def mitsuba_scene(scene, sky, irradiance, albedo):
    import mitsuba as mi
    import numpy as np

    mi.set_variant("scalar_rgb")
    T = mi.ScalarTransform4f
    mesh = mi.Mesh("tree", len(scene.vertices), len(scene.triangles))
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = scene.vertices.ravel()
    parameters["faces"] = scene.triangles.ravel()
    parameters.update()
    ply = os.path.join(scene.folder, "tree.ply")
    mesh.write_ply(ply)
    rgb = lambda value: {"type": "rgb", "value": [float(part) for part in value]}
    matt = lambda value: {"type": "twosided", "side": {"type": "diffuse", "reflectance": rgb(value)}}
    width, height = SIZE
    description = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": BOUNCES + 1},
        "sensor": {"type": "perspective", "fov": FOV, "fov_axis": "x", "far_clip": 1e6,
                   "to_world": T().look_at(origin=scene.eye.tolist(), target=scene.target.tolist(), up=[0, 0, 1]),
                   "film": {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"}},
                   "sampler": {"type": "independent"}},
        # Mitsuba's map has Y up; turned, its columns run clockwise from north.
        "sky": {"type": "envmap", "bitmap": mi.Bitmap(sky.astype("float32")),
                "to_world": T().rotate([1, 0, 0], 90)},
        "sun": {"type": "directional", "direction": (-toward_sun()).tolist(), "irradiance": rgb(irradiance)},
        "ground": {"type": "rectangle", "to_world": T().scale([3000, 3000, 1]), "bsdf": matt(albedo["ground"])},
        "tree": {"type": "shapegroup", "mesh": {"type": "ply", "filename": ply, "face_normals": True,
                                                "bsdf": matt(albedo["plants"])}},
    }
    for i, (x, y, angle, scale) in enumerate(zip(scene.x, scene.y, scene.angle, scene.scale)):
        place = T().translate([float(x), float(y), 0]) @ T().rotate([0, 0, 1], math.degrees(angle)) @ T().scale([float(scale)] * 3)
        description[f"i{i}"] = {"type": "instance", "to_world": place, "group": {"type": "ref", "id": "tree"}}
    return mi.load_dict(description)


def reflectances(picture):
    """Mean albedo of plants and of the ground, over pixels that show nothing else."""
    import numpy as np

    albedo, species, depth = colour(picture, "albedo."), picture["species"], picture["Z"]
    is_plant = species == species.max()
    is_ground = (species == 0) & (depth < 1e3)
    return {"plants": albedo[is_plant].mean(0), "ground": albedo[is_ground].mean(0)}


def compare(arguments, count):
    import mitsuba as mi
    import numpy as np

    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryDirectory() as open_folder:
        scene = Scene(folder, arguments.weald, count)
        sky, irradiance = sky_of(Scene(open_folder, arguments.weald, 1))
        few, many = 1, 1 + arguments.samples
        albedo = reflectances(scene.render(many)[0])
        theirs = mitsuba_scene(scene, sky, irradiance, albedo)
        times = {"weald": [], "Mitsuba scalar_rgb": []}
        for seed in range(arguments.repeat):
            _, *start = scene.render(few)
            ours, *whole = scene.render(many)
            times["weald"].append([b - a for a, b in zip(start, whole)])
            wall, cpu = time.perf_counter(), time.process_time()
            picture = np.array(mi.render(theirs, spp=arguments.samples, seed=seed), "float64")[..., :3]
            times["Mitsuba scalar_rgb"].append([time.perf_counter() - wall, time.process_time() - cpu])
    paths = SIZE[0] * SIZE[1] * arguments.samples / 1e6
    print(f"{count} trees of {len(scene.triangles)} triangles, {SIZE[0]} x {SIZE[1]}, {arguments.samples} samples, "
          f"{BOUNCES} bounces, medians of {arguments.repeat}")
    median = {name: [statistics.median(part) for part in zip(*runs)] for name, runs in times.items()}
    for name, (wall, cpu) in median.items():
        print(f"{name:<24}{cpu:>8.2f} CPU s{wall:>8.2f} wall s{paths / cpu:>10.4f} M samples a CPU second")
    print(f"weald / Mitsuba: {median['Mitsuba scalar_rgb'][1] / median['weald'][1]:.2f}")
    ours = colour(ours)
    ratio = ours.mean((0, 1)) / picture.mean((0, 1))
    print(f"means of the pictures, ours over theirs: {', '.join(f'{part:.4f}' for part in ratio)}\n")
    if arguments.keep:
        os.makedirs(arguments.keep, exist_ok=True)
        scale = 0.6 / np.percentile(ours, 90)
        for name, image in (("weald", ours), ("mitsuba", picture)):
            mi.Bitmap((image * scale).astype("float32")).convert(
                mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.UInt8, True).write(
                os.path.join(arguments.keep, f"{name}-{count}.png"))
    return abs(ratio.mean() - 1) <= TOLERANCE


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--venv", required=True, help="folder of the virtual environment")
    parser.add_argument("--weald", default="target/release/weald")
    parser.add_argument("--trees", type=int, nargs="+", default=[1000])
    parser.add_argument("--samples", type=int, default=8)
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--keep", metavar="FOLDER", help="keep both pictures there, as PNG")
    arguments = parser.parse_args()
    enter(arguments.venv)
    sys.exit(0 if all([compare(arguments, count) for count in arguments.trees]) else 1)


if __name__ == "__main__":
    main()
