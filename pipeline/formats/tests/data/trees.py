#!/usr/bin/env python3
"""Writes trees.gpkg: a GeoPackage of 700 points, with the SQLite of Python."""

import os
import sqlite3
import struct
import sys

path = os.path.join(os.path.dirname(os.path.abspath(sys.argv[0])), "trees.gpkg")
if os.path.exists(path):
    os.remove(path)
base = sqlite3.connect(path)
base.executescript(
    """
    PRAGMA page_size = 512;
    PRAGMA application_id = 0x47504B47;
    CREATE TABLE gpkg_spatial_ref_sys (srs_name TEXT NOT NULL, srs_id INTEGER NOT NULL PRIMARY KEY,
      organization TEXT NOT NULL, organization_coordsys_id INTEGER NOT NULL,
      definition TEXT NOT NULL, description TEXT);
    CREATE TABLE gpkg_contents (table_name TEXT NOT NULL PRIMARY KEY, data_type TEXT NOT NULL,
      identifier TEXT UNIQUE, description TEXT DEFAULT '', last_change DATETIME NOT NULL,
      min_x DOUBLE, min_y DOUBLE, max_x DOUBLE, max_y DOUBLE, srs_id INTEGER);
    CREATE TABLE gpkg_geometry_columns (table_name TEXT NOT NULL, column_name TEXT NOT NULL,
      geometry_type_name TEXT NOT NULL, srs_id INTEGER NOT NULL, z TINYINT NOT NULL,
      m TINYINT NOT NULL, CONSTRAINT pk_geom_cols PRIMARY KEY (table_name, column_name));
    CREATE TABLE "trees" ("fid" INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, "geom" POINT,
      "species" TEXT(20), "dbh_cm" REAL, "note" TEXT);
    """
)
base.executemany(
    "INSERT INTO gpkg_spatial_ref_sys VALUES (?, ?, ?, ?, ?, NULL)",
    [
        ("WGS 84", 4326, "EPSG", 4326, 'GEOGCS["WGS 84"]'),
        ("NAD83 / UTM zone 15N", 26915, "EPSG", 26915, 'PROJCS["NAD83 / UTM zone 15N"]'),
    ],
)
base.execute(
    "INSERT INTO gpkg_contents VALUES ('trees', 'features', 'trees', '', '2026-01-01T00:00:00Z',"
    " NULL, NULL, NULL, NULL, 26915)"
)
base.execute("INSERT INTO gpkg_geometry_columns VALUES ('trees', 'geom', 'POINT', 26915, 0, 0)")
for row in range(700):
    x, y = 481000.0 + row, 5250000.0 - 0.5 * row
    # Every second geometry has an envelope, as GDAL writes for what is no point.
    has_envelope = row % 2
    head = b"GP" + struct.pack("<BBi", 0, 1 | has_envelope << 1, 26915)
    envelope = struct.pack("<4d", x, x, y, y) if has_envelope else b""
    blob = head + envelope + struct.pack("<BI2d", 1, 1, x, y)
    note = "n" * 9000 if row == 4 else None
    base.execute(
        "INSERT INTO trees (geom, species, dbh_cm, note) VALUES (?, ?, ?, ?)",
        (blob, ["oak", "ash"][row % 2], row / 8, note),
    )
base.commit()
base.close()
