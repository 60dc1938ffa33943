//! The reference system beside an ESRI ASCII grid: `NAME.prj`, in well-known text [OGC18-010].

use crate::bytes::read_text;
use crate::error::{Error, Result};
use std::path::{Path, PathBuf};
use weald_contract::{Crs, UtmZone};

/// Longest text that is read; a system takes some 2,000 bytes.
const MAX_BYTES: u64 = 1 << 20;

/// Deepest nesting that is read; well-known text nests some eight deep.
const MAX_DEPTH: usize = 32;

/// How far numbers of a UTM zone may be from round ones: files differ in the digits they keep.
const NEAR: f64 = 1e-6;

/// Geographic systems by the names of their datums, letters and digits alone [EPSG].
const DATUMS: [(u32, [&str; 3]); 3] = [
    (4326, ["wgs1984", "worldgeodeticsystem1984", "wgs84"]),
    (4269, ["northamerican1983", "northamericandatum1983", "nad83"]),
    (4258, ["etrs1989", "europeanterrestrialreferencesystem1989", "etrs89"]),
];

/// The file that says the reference system of `raster`, where there is one.
pub(crate) fn beside(raster: &Path) -> Option<PathBuf> {
    ["prj", "PRJ"].map(|ending| raster.with_extension(ending)).into_iter().find(|p| p.is_file())
}

/// Reads a reference system: its EPSG code where the text names it or it is a UTM zone, and
/// whether its coordinates are degrees.
///
/// # Errors
/// When the text is no reference system, is in another unit than the metre, or is geographic on
/// a datum other than WGS 84, NAD83 and ETRS89.
pub(crate) fn read(path: &Path) -> Result<Crs> {
    parse(path, &read_text(path, MAX_BYTES)?)
}

fn parse(path: &Path, text: &str) -> Result<Crs> {
    let mut rest = text.trim();
    let root = Node::read(&mut rest, 0).filter(|_| rest.trim().is_empty());
    let system = root.as_ref().and_then(|root| root.find(&Node::is_system)).ok_or_else(|| {
        let hint = "well-known text begins with PROJCS, GEOGCS or their like; \
                    `gdalsrsinfo -o wkt_esri EPSG:CODE` writes it";
        Error::invalid(path, "this is not a reference system in well-known text", hint)
    })?;
    if system.is_geographic() {
        let epsg = geographic(path, system)?;
        return Ok(Crs { epsg: Some(epsg), is_geographic: true, ..Crs::default() });
    }
    let unit = system.child(&["UNIT", "LENGTHUNIT"]).and_then(|unit| unit.numbers().next());
    if unit.is_some_and(|metres| (metres - 1.0).abs() > NEAR) {
        let message = format!("a map in units of {} m", unit.unwrap_or_default());
        let hint = "coordinates must be metres: `gdalwarp -t_srs EPSG:UTM_ZONE`";
        return Err(Error::unsupported(path, message, hint));
    }
    Ok(Crs { epsg: system.code().or_else(|| utm(system)), ..Crs::default() })
}

/// EPSG code of a geographic system.
fn geographic(path: &Path, system: &Node<'_>) -> Result<u32> {
    let known = |code: &u32| DATUMS.iter().any(|(known, _)| known == code);
    system.code().filter(known).or_else(|| datum(system)).ok_or_else(|| {
        let message = format!("longitude and latitude in `{}`", system.title());
        let hint = "WGS 84, NAD83 and ETRS89 are: `gdalwarp -t_srs EPSG:4326`";
        Error::unsupported(path, message, hint)
    })
}

/// EPSG code of the geographic system on the datum that a system stands on.
fn datum(system: &Node<'_>) -> Option<u32> {
    let datum = system.find(&|node| node.is(&["DATUM", "ENSEMBLE", "TRF"]))?.title();
    // ESRI marks datums by a `D_`.
    let name = plain(datum.strip_prefix("D_").unwrap_or(datum));
    let name = name.strip_suffix("ensemble").unwrap_or(&name);
    DATUMS.iter().find(|(_, names)| names.contains(&name)).map(|(code, _)| *code)
}

/// EPSG code of a UTM zone that is described, not named.
fn utm(system: &Node<'_>) -> Option<u32> {
    let projection = system.find(&|node| node.is(&["PROJECTION", "METHOD"]))?;
    let value = |names: [&str; 2]| {
        let is_it =
            |node: &Node<'_>| node.is(&["PARAMETER"]) && names.contains(&&*plain(node.title()));
        system.find(&is_it)?.numbers().next()
    };
    let is = |names, wanted: f64| value(names).is_some_and(|v| (v - wanted).abs() < NEAR);
    let is_mercator = plain(projection.title()) == "transversemercator"
        && is(["scalefactor", "scalefactoratnaturalorigin"], 0.9996)
        && is(["falseeasting", "falseeasting"], 500_000.0)
        && is(["latitudeoforigin", "latitudeofnaturalorigin"], 0.0);
    let zone = (value(["centralmeridian", "longitudeofnaturalorigin"])? + 183.0) / 6.0;
    let is_zone = (zone - zone.round()).abs() < NEAR && (1.0..=60.0).contains(&zone.round());
    let northing = ["falsenorthing", "falsenorthing"];
    let is_south = is(northing, 10_000_000.0);
    if !(is_mercator && is_zone && (is_south || is(northing, 0.0))) {
        return None;
    }
    let first = match (datum(system)?, is_south) {
        (4326, false) => 32600,
        (4326, true) => 32700,
        (4269, false) => 26900,
        (4258, false) => 25800,
        _ => return None,
    };
    let code = first + zone.round() as u32;
    UtmZone::from_epsg(code).map(|_| code)
}

/// Letters and digits of a name, in lower case: files spell the same name in many ways.
fn plain(name: &str) -> String {
    name.chars().filter(char::is_ascii_alphanumeric).collect::<String>().to_lowercase()
}

/// `KEYWORD[argument, …]`.
#[derive(Debug)]
struct Node<'a> {
    keyword: &'a str,
    arguments: Vec<Argument<'a>>,
}

#[derive(Debug)]
enum Argument<'a> {
    Node(Node<'a>),
    /// Text in quotes, or a bare word or number.
    Word(&'a str),
}

impl<'a> Node<'a> {
    /// Reads a node off the front of `rest`; `None` where there is none.
    fn read(rest: &mut &'a str, depth: usize) -> Option<Self> {
        let end = rest.find(|c: char| !(c.is_ascii_alphanumeric() || c == '_'))?;
        let (keyword, after) = rest.split_at(end);
        let mut inner = after.trim_start().strip_prefix(['[', '('])?;
        if keyword.is_empty() || depth > MAX_DEPTH {
            return None;
        }
        let mut arguments = Vec::new();
        loop {
            inner = inner.trim_start();
            arguments.push(Argument::read(&mut inner, depth)?);
            inner = inner.trim_start();
            let next = inner.chars().next()?;
            inner = &inner[next.len_utf8()..];
            match next {
                ',' => {}
                ']' | ')' => break,
                _ => return None,
            }
        }
        *rest = inner;
        Some(Self { keyword, arguments })
    }

    fn is(&self, keywords: &[&str]) -> bool {
        keywords.iter().any(|keyword| keyword.eq_ignore_ascii_case(self.keyword))
    }

    fn is_geographic(&self) -> bool {
        self.is(&["GEOGCS", "GEOGCRS", "GEOGRAPHICCRS", "GEODCRS", "GEODETICCRS"])
    }

    /// Whether this is a horizontal system by itself, not one that another is built on.
    fn is_system(&self) -> bool {
        self.is_geographic()
            || self.is(&["PROJCS", "PROJCRS", "PROJECTEDCRS", "LOCAL_CS", "ENGCRS"])
    }

    /// First argument, where it is a word.
    fn title(&self) -> &'a str {
        match self.arguments.first() {
            Some(Argument::Word(word)) => word,
            _ => "",
        }
    }

    fn numbers(&self) -> impl Iterator<Item = f64> {
        self.arguments.iter().filter_map(|argument| match argument {
            Argument::Word(word) => word.parse().ok(),
            Argument::Node(_) => None,
        })
    }

    fn nodes(&self) -> impl Iterator<Item = &Self> {
        self.arguments.iter().filter_map(|argument| match argument {
            Argument::Node(node) => Some(node),
            Argument::Word(_) => None,
        })
    }

    fn child(&self, keywords: &[&str]) -> Option<&Self> {
        self.nodes().find(|node| node.is(keywords))
    }

    /// The first node that is wanted: this one, or one within it, outer ones first on each way.
    fn find(&self, is_wanted: &dyn Fn(&Self) -> bool) -> Option<&Self> {
        if is_wanted(self) {
            return Some(self);
        }
        self.nodes().find_map(|node| node.find(is_wanted))
    }

    /// EPSG code that the node itself bears.
    fn code(&self) -> Option<u32> {
        let id = self.child(&["AUTHORITY", "ID"]).filter(|id| id.title() == "EPSG")?;
        match id.arguments.get(1)? {
            Argument::Word(word) => word.parse().ok(),
            Argument::Node(_) => None,
        }
    }
}

impl<'a> Argument<'a> {
    fn read(rest: &mut &'a str, depth: usize) -> Option<Self> {
        if let Some(quoted) = rest.strip_prefix('"') {
            let (text, after) = quoted.split_once('"')?;
            *rest = after;
            return Some(Self::Word(text));
        }
        // Told by what ends the word, never by trying both: nested tries would take time that
        // doubles with each level.
        let end = rest.find([',', ']', ')', '[', '('])?;
        if rest[end..].starts_with(['[', '(']) {
            return Node::read(rest, depth + 1).map(Self::Node);
        }
        let (word, after) = rest.split_at(end);
        *rest = after;
        Some(Self::Word(word.trim()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn read_text(text: &str) -> Result<Crs> {
        parse(Path::new("dem.prj"), text)
    }

    fn esri(name: &str, datum: &str, meridian: f64, northing: f64, unit: &str) -> String {
        format!(
            r#"PROJCS["{name}",GEOGCS["GCS",DATUM["{datum}",SPHEROID["S",6378137.0,298.25]],
            PRIMEM["Greenwich",0.0],UNIT["Degree",0.0174532925199433]],
            PROJECTION["Transverse_Mercator"],PARAMETER["False_Easting",500000.0],
            PARAMETER["False_Northing",{northing:?}],PARAMETER["Central_Meridian",{meridian:?}],
            PARAMETER["Scale_Factor",0.9996],PARAMETER["Latitude_Of_Origin",0.0],UNIT{unit}]"#
        )
    }

    #[test]
    fn utm_zones_are_known_by_what_they_are() {
        let metre = r#"["Meter",1.0]"#;
        let cases = [
            ("D_WGS_1984", -105.0, 0.0, Some(32613)),
            ("D_North_American_1983", -105.0, 0.0, Some(26913)),
            ("D_ETRS_1989", 9.0, 0.0, Some(25832)),
            ("D_WGS_1984", -69.0, 1e7, Some(32719)),
            // NAD83(2011), and a meridian and a northing of no zone.
            ("D_NAD_1983_2011", -105.0, 0.0, None),
            ("D_WGS_1984", -104.0, 0.0, None),
            ("D_WGS_1984", -105.0, 5.0, None),
        ];
        for (datum, meridian, northing, wanted) in cases {
            let crs = read_text(&esri("any name", datum, meridian, northing, metre)).unwrap();
            assert_eq!((crs.epsg, crs.is_geographic), (wanted, false), "{datum} {meridian}");
        }
    }

    #[test]
    fn codes_that_the_text_bears_are_believed() {
        // The base's own code is not the system's.
        let second = r#"PROJCRS["WGS 84 / UTM zone 19S", BASEGEOGCRS["WGS 84",
            ENSEMBLE["World Geodetic System 1984 ensemble", MEMBER["G730"],
                ELLIPSOID["WGS 84",6378137,298.257223563,LENGTHUNIT["metre",1]]],
            ID["EPSG",4326]],
            CONVERSION["UTM zone 19S",METHOD["Transverse Mercator",ID["EPSG",9807]],
                PARAMETER["Latitude of natural origin",0],
                PARAMETER["Longitude of natural origin",-69],
                PARAMETER["Scale factor at natural origin",0.9996],
                PARAMETER["False easting",500000],PARAMETER["False northing",10000000]],
            CS[Cartesian,2],AXIS["(E)",east,ORDER[1],LENGTHUNIT["metre",1]],
            ID["EPSG",32719]]"#;
        assert_eq!(read_text(second).unwrap().epsg, Some(32719));
        let described = second.replace("ID[\"EPSG\",32719]", "REMARK[\"by hand\"]");
        assert_eq!(read_text(&described).unwrap().epsg, Some(32719));
        let lambert = r#"PROJCS["RGF93", GEOGCS["g", DATUM["d"]], UNIT["metre", 1,
            AUTHORITY["EPSG", "9001"]], AUTHORITY["EPSG", "2154"]]"#;
        assert_eq!(read_text(lambert).unwrap().epsg, Some(2154));
        let compound = format!("COMPD_CS[\"both\", {lambert}, VERT_CS[\"height\"]]");
        assert_eq!(read_text(&compound).unwrap().epsg, Some(2154));
    }

    #[test]
    fn degrees_are_told_by_their_datum() {
        let degrees = |datum: &str| {
            format!(r#"GEOGCS["GCS",DATUM["{datum}",SPHEROID["s",1,2]],UNIT["Degree",0.0174]]"#)
        };
        for (datum, wanted) in [("D_WGS_1984", 4326), ("North_American_Datum_1983", 4269)] {
            let crs = read_text(&degrees(datum)).unwrap();
            assert_eq!((crs.epsg, crs.is_geographic), (Some(wanted), true));
        }
        let error = read_text(&degrees("D_North_American_1927")).unwrap_err().to_string();
        assert!(error.contains("`GCS`") && error.contains("NAD83"), "{error}");
    }

    #[test]
    fn feet_and_other_texts_are_refused() {
        let feet = esri("n", "D_WGS_1984", 9.0, 0.0, r#"["Foot_US",0.304800609601219]"#);
        let error = read_text(&feet).unwrap_err().to_string();
        assert!(error.contains("0.3048") && error.contains("metres"), "{error}");
        for text in ["", "Projection UTM\nZone 13", "PROJCS[", "PROJCS[]]", "VERT_CS[\"h\"]"] {
            let error = read_text(text).unwrap_err().to_string();
            assert!(error.contains("well-known text"), "{text}: {error}");
        }
        for unclosed in ["A[", "A[1,", "A[1,B[2],", "A[\"x\",A[1],A["] {
            assert!(read_text(&unclosed.repeat(1 << 16)).is_err(), "{unclosed}");
        }
    }

    proptest! {
        #[test]
        fn no_text_panics(text in "[A-Z\\[\\](),\"0-9.é -]{0,80}") {
            let _ = read_text(&text);
            let _ = read_text(&format!("PROJCS[\"a\",{text}]"));
        }
    }
}
