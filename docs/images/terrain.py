#!/usr/bin/env python3
"""Draws terrain-masks.png, terrain-levels.png and terrain-layers.png of docs/terrain.md.

    pip install numpy pillow rasterio
    python docs/images/terrain.py target/release/weald
"""
import json
import pathlib
import subprocess
import sys
import tempfile

import numpy
import rasterio
from PIL import Image, ImageDraw

HERE = pathlib.Path(__file__).resolve().parent
TILE = (256, 192)
GROUND = """
[terrain]
source = "{dem}"
crop = [150, 110, 390, 290]
layers = {layers}
[[terrain.op]]
op = "smooth"
radius = 1.0
"""
MASKS = {
    "slope_deg": 'slope_deg = [15, 90], falloff = 5',
    "altitude": 'altitude = [385, 389]',
    "aspect_deg": 'aspect_deg = [315, 45], falloff = 20',
    "curvature_plan": 'curvature_plan = [0.02, 10], falloff = 0.02',
    "curvature_profile": 'curvature_profile = [-10, -0.003], falloff = 0.003',
    "upslope_area": 'upslope_area = [400, 1e9], falloff = 200',
    "wetness": 'wetness = [5, 99], falloff = 1',
    "disc": 'disc = { at = [120, 90], radius = 50 }, feather = 25',
    "rectangle": 'rectangle = [50, 40, 190, 140]',
    "polygon": 'polygon = [[40, 30], [200, 60], [150, 150], [110, 90]], feather = 8',
    "footprint": 'footprint = { model = "house.obj", at = [120, 90], yaw_deg = 25, scale = 3 }, feather = 3',
    "line": 'line = { points = [[10, 20], [90, 120], [230, 150]], width = 14 }, feather = 12',
    "noise": 'noise = { wavelength = 40, range = [-0.1, 0.2] }',
    "image": 'image = "garden.png"',
    "formula": 'formula = "0.5 + 0.5 * cos(altitude * 2 * pi / 3)"',
}
OPERATORS = {
    "offset": 'op = "offset"\nby = 5\nmask = { disc = { at = [120, 90], radius = 40 }, feather = 15 }',
    "scale": 'op = "scale"\nfactor = 2\nabout = 380',
    "clamp": 'op = "clamp"\nlow = 384\nhigh = 392',
    "flatten": 'op = "flatten"\naltitude = 388\n'
               'mask = { polygon = [[70, 40], [180, 60], [170, 130], [60, 120]], feather = 10 }',
    "translate": 'op = "translate"\nby = [50, -30]',
    "breach": 'op = "breach"\nmax_depth = 6\nmax_length = 200',
}
LAKE = '[[terrain.op]]\nop = "lake"\nat = [140, 95]\nlevel = 381.6\n'
LAYERS = ["altitude", "filled", "water_depth", "slope", "aspect", "northness", "eastness",
          "normal_east", "normal_north", "normal_up", "curvature_plan", "curvature_profile", "upslope_area", "specific_catchment_area", "wetness",
          "wetness_suction", "height_above_drainage", "soil_moisture", "soil_water", "soil_depth",
          "insolation", "sky_view", "heat_load", "temperature"]
# Layers of areas span many powers of ten.
LOGARITHMIC = ["upslope_area", "specific_catchment_area"]
# From dark blue over green to yellow.
RAMP = [(35, 25, 90), (30, 95, 140), (50, 150, 130), (140, 195, 90), (250, 230, 60)]
# An L of two wings, Y up, 16 m by 12 m.
HOUSE = "\n".join(
    ["v %g 0 %g" % corner for corner in
     [(-8, -6), (8, -6), (8, 0), (-2, 0), (-2, 6), (-8, 6)]] + ["f 1 2 3 4", "f 1 4 5 6", ""])


def sheet(tiles, columns, path):
    rows = -(-len(tiles) // columns)
    whole = Image.new("RGB", (columns * TILE[0], rows * TILE[1]))
    draw = ImageDraw.Draw(whole)
    for i, (name, tile) in enumerate(tiles):
        x, y = i % columns * TILE[0], i // columns * TILE[1]
        whole.paste(tile.resize(TILE, Image.LANCZOS), (x, y))
        draw.rectangle((x, y, x + 8 + draw.textlength(name), y + 15), fill="white")
        draw.text((x + 4, y + 2), name, fill="black")
    whole.quantize(200).save(path, optimize=True)


def terrain(weald, folder, name, text, layers=()):
    """Preview of a terrain, and its folder of layers."""
    dem = HERE.parents[1] / "scenes/pond/inputs/lidar_dem.tif"
    scene, made = folder / f"{name}.toml", folder / name
    scene.write_text(GROUND.format(dem=dem, layers=json.dumps(layers)) + text)
    subprocess.run([weald, "terrain", scene, "-o", made, "-q"], check=True)
    return Image.open(folder / f"{name}.png").convert("RGB"), made


def mask(weald, folder, name, condition):
    """The ground in gray, and in red where the mask holds: soil is made wet there, dry elsewhere."""
    wet = '[[terrain.op]]\nop = "layer"\nlayer = "soil_moisture"\nvalue = %d\n'
    text = wet % 0 + wet % 1 + f"mask = {{ {condition} }}\n"
    ground, layers = terrain(weald, folder, name, text)
    with rasterio.open(layers / "soil_moisture.tif") as file:
        weight = Image.fromarray((file.read(1) * 255).astype("uint8")).resize(ground.size)
    gray = ground.convert("L").convert("RGB")
    red = Image.blend(gray, Image.new("RGB", ground.size, (230, 30, 20)), 0.7)
    return Image.composite(red, gray, weight)


def layer(folder, name):
    """A layer from its lowest to its highest values, but for one in a hundred at each end."""
    with rasterio.open(folder / f"{name}.tif") as file:
        values, unit = file.read(1), file.units[0]
    low, high = numpy.percentile(values, [1, 99])
    scale = numpy.log if name in LOGARITHMIC else lambda value: value
    share = (scale(values.clip(low, high)) - scale(low)) / max(scale(high) - scale(low), 1e-9)
    stops = numpy.linspace(0, 1, len(RAMP))
    color = [numpy.interp(share, stops, channel) for channel in zip(*RAMP)]
    picture = Image.fromarray(numpy.stack(color, axis=-1).astype("uint8"))
    return f"{name}: {low:.3g} to {high:.3g} {unit}", picture


def main(weald):
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        (folder / "house.obj").write_text(HOUSE)
        garden = HERE.parents[1] / "scenes/garden/inputs/beds.png"
        (folder / "garden.png").write_bytes(garden.read_bytes())
        masks = [(name, mask(weald, folder, name, text)) for name, text in MASKS.items()]
        sheet(masks, 5, HERE / "terrain-masks.png")
        forms = [(name, terrain(weald, folder, name, f"[[terrain.op]]\n{text}\n")[0])
                 for name, text in OPERATORS.items()]
        sheet(forms, 3, HERE / "terrain-levels.png")
        wanted = [name for name in LAYERS if "normal" not in name] + ["normal"]
        _, layers = terrain(weald, folder, "layers", LAKE, wanted)
        sheet([layer(layers, name) for name in LAYERS], 4, HERE / "terrain-layers.png")


main(pathlib.Path(sys.argv[1]).resolve())
