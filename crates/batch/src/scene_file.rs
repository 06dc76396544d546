//! Scene files, `hullcast.scene.v1`: hulls, bodies, configurations and pairs.
//!
//! `examples/scenes/README.md` describes the format. Unknown keys are ignored, so that a file may state
//! its origin.

mod values;

use std::collections::HashMap;
use std::io::{self, Read};
use std::path::Path;

use serde::Deserialize;
use serde_json::error::Category;
use thiserror::Error;

use self::values::{JsonIndex, JsonNumber, JsonRow, optional, point, rows};
use crate::counted;
use hullcast_contact::Pose;

const FORMAT: &str = "hullcast.scene.v1";

/// Bodies in one or more configurations, and the pairs to query.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneFile {
    /// Name for display.
    pub name: String,
    /// The hulls, each in its own frame.
    pub hulls: Vec<HullPoints>,
    /// For each body, an index into `hulls`.
    pub body_hulls: Vec<u32>,
    /// For each body, a name for display.
    pub body_names: Vec<String>,
    /// The configurations, at least one.
    pub frames: Vec<Frame>,
    /// Two body indices per pair.
    pub pairs: Vec<u32>,
    /// Contact points are computed for hulls within this distance, caller's units.
    pub margin: f64,
    /// Empty, or for each body a length that is added to the margin of its pairs.
    pub margins: Vec<f64>,
}

/// A hull as it is registered.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct HullPoints {
    /// Name for display.
    #[serde(default)]
    pub name: String,
    /// Points, hull frame, caller's units.
    #[serde(deserialize_with = "rows")]
    pub vertices: Vec<[f64; 3]>,
    /// Contraction point, hull frame; the centre of mass if absent.
    #[serde(default, deserialize_with = "point")]
    pub contraction_point: Option<[f64; 3]>,
    /// The planarity to register with, as a fraction of the circumradius. A file without this key means
    /// [`DEFAULT_PLANARITY`]; `null` means to register without a planarity.
    #[serde(default = "default_planarity", deserialize_with = "optional")]
    pub planarity: Option<f64>,
}

/// The planarity of hulls whose scene file has no planarity. It was measured on shapes whose
/// coordinates are rounded as in common files (docs/tradeoff.md).
const DEFAULT_PLANARITY: f64 = 1e-3;

#[allow(clippy::unnecessary_wraps, reason = "serde wants the field's type")]
fn default_planarity() -> Option<f64> {
    Some(DEFAULT_PLANARITY)
}

/// The pose of every body.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// Name for display; empty if the file has no frames.
    pub name: String,
    /// 3 numbers per body.
    pub positions: Vec<f64>,
    /// 4 numbers per body: x, y, z, w.
    pub rotations: Vec<f64>,
}

/// A defect of a scene file, and its place.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{}{}{message}", before(.file), before(.place))]
pub struct SceneFileError {
    /// The file as the user gave it, with its option if it has one; empty if there is no file.
    pub file: String,
    /// The place, such as `hulls[3].vertices[7]`; empty for the whole file.
    pub place: String,
    /// The defect, for display.
    pub message: String,
}

/// A part of an error's text that stands before the rest of it, if the part is known.
fn before(part: &str) -> String {
    if part.is_empty() { String::new() } else { format!("{part}: ") }
}

/// A scene has bodies at poses that no query accepts. The text names the configuration and the bodies.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{0}")]
pub struct UnusablePoses(String);

#[derive(Deserialize)]
struct JsonScene {
    format: String,
    name: String,
    hulls: Vec<HullPoints>,
    bodies: Vec<JsonBody>,
    #[serde(default)]
    frames: Vec<JsonFrame>,
    pairs: Vec<JsonRow<JsonIndex, 2>>,
    #[serde(default)]
    margin: JsonNumber,
    #[serde(default)]
    margins: Option<Vec<JsonNumber>>,
}

#[derive(Deserialize)]
struct JsonBody {
    #[serde(default)]
    name: String,
    hull: JsonIndex,
    position: JsonRow<JsonNumber, 3>,
    rotation: JsonRow<JsonNumber, 4>,
}

#[derive(Deserialize)]
struct JsonFrame {
    #[serde(default)]
    name: String,
    #[serde(deserialize_with = "rows")]
    positions: Vec<[f64; 3]>,
    #[serde(deserialize_with = "rows")]
    rotations: Vec<[f64; 4]>,
}

impl SceneFile {
    /// Reads a scene file; `-` stands for the standard input. `option` is the option that names the file,
    /// or empty.
    ///
    /// # Errors
    /// [`SceneFileError`] names file, field and index at fault.
    pub fn read(option: &str, path: &Path) -> Result<Self, SceneFileError> {
        let piped = path == Path::new("-");
        let file = shown(option, path);
        let fault = |message| SceneFileError { file: file.clone(), place: String::new(), message };
        let text = if piped {
            let mut text = Vec::new();
            io::stdin().lock().read_to_end(&mut text).map(|_| text)
        } else {
            std::fs::read(path)
        };
        let text = text.map_err(|e| fault(format!("cannot be read: {e}")))?;
        Self::parse(&text).map_err(|e| SceneFileError { file: file.clone(), ..e })
    }

    /// Reads a scene from JSON text.
    ///
    /// # Errors
    /// [`SceneFileError`] names the field and index at fault.
    pub fn parse(text: &[u8]) -> Result<Self, SceneFileError> {
        let mut json = serde_json::Deserializer::from_slice(text);
        let file: JsonScene = serde_path_to_error::deserialize(&mut json).map_err(|e| {
            let place = e.path().to_string();
            not_a_scene(if place == "." { String::new() } else { place }, &e.into_inner())
        })?;
        json.end().map_err(|e| not_a_scene(String::new(), &e))?;
        file.check()?;
        Ok(file.into_scene())
    }

    /// Fails if a pose of any configuration is unusable, because its pairs would be INVALID.
    ///
    /// # Errors
    /// [`UnusablePoses`] names the configuration, and the number and the indices of the bodies with such
    /// poses.
    pub fn check_poses(&self) -> Result<(), UnusablePoses> {
        for (number, frame) in self.frames.iter().enumerate() {
            let (positions, rotations) = (frame.positions.as_chunks().0, frame.rotations.as_chunks().0);
            let poses = (0..).zip(positions.iter().zip(rotations));
            let unusable = poses.filter(|&(_, (&at, &turned))| Pose::check(at, turned).is_err());
            let unusable: Vec<u32> = unusable.map(|(body, _)| body).collect();
            if !unusable.is_empty() {
                let text = unusable_poses(&unusable, self.body_hulls.len());
                return Err(UnusablePoses(format!("{}, configuration {number}: {text}", self.name)));
            }
        }
        Ok(())
    }
}

/// A scene file as errors name it: the option that names the file, if there is one, and the path. `-` stands for
/// the standard input.
pub fn shown(option: &str, path: &Path) -> String {
    let path = if path == Path::new("-") { "the standard input".into() } else { path.display().to_string() };
    if option.is_empty() { path } else { format!("{option} {path}") }
}

/// The text of the error for the unusable poses of the bodies `unusable`, out of all `bodies`.
pub fn unusable_poses(unusable: &[u32], bodies: usize) -> String {
    const SHOWN: usize = 8;
    let mut names: Vec<String> = unusable.iter().take(SHOWN).map(u32::to_string).collect();
    if unusable.len() > SHOWN {
        names.push("...".into());
    }
    format!(
        "unusable poses: {} of {} (bodies {}), where a position is finite and at most 1e100, and a \
         quaternion's norm 0.25 to 4",
        unusable.len(),
        counted(bodies, "body"),
        names.join(", ")
    )
}

/// The error for a text that is not a scene: it is not JSON, or it is JSON with another content.
fn not_a_scene(place: String, error: &serde_json::Error) -> SceneFileError {
    let message = match error.classify() {
        Category::Data => error.to_string(),
        Category::Io | Category::Syntax | Category::Eof => {
            format!("not JSON ({error}); expected a scene file, {FORMAT}")
        }
    };
    SceneFileError { file: String::new(), place, message }
}

/// The text about an index of one of `count` things, or `None` if there is such a thing.
fn out_of_range(JsonIndex(index): JsonIndex, count: usize, thing: &str) -> Option<String> {
    let allowed = match count.checked_sub(1) {
        _ if (index as usize) < count => return None,
        None => "no index is allowed".into(),
        Some(0) => "expected 0".into(),
        Some(last) => format!("expected 0 to {last}"),
    };
    Some(format!("is {index}, {allowed}: the scene has {}", counted(count, thing)))
}

impl JsonScene {
    /// Checks the rules that the types do not express: indices in range, and one pose per body.
    fn check(&self) -> Result<(), SceneFileError> {
        let fail =
            |place: String, message: String| Err(SceneFileError { file: String::new(), place, message });
        if self.format != FORMAT {
            return fail("format".into(), format!("is {:?}, expected {FORMAT:?}", self.format));
        }
        for (i, body) in self.bodies.iter().enumerate() {
            if let Some(wrong) = out_of_range(body.hull, self.hulls.len(), "hull") {
                return fail(format!("bodies[{i}].hull"), wrong);
            }
        }
        let mut named: HashMap<&str, usize> = HashMap::new();
        for (i, frame) in self.frames.iter().enumerate() {
            // A user who names a configuration would get either of two that have one name.
            if !frame.name.is_empty()
                && let Some(first) = named.insert(&frame.name, i)
            {
                return fail(
                    format!("frames[{i}].name"),
                    format!("frames[{first}] has the name {:?} too, expected another name", frame.name),
                );
            }
            for (key, count) in [("positions", frame.positions.len()), ("rotations", frame.rotations.len())] {
                if count != self.bodies.len() {
                    return fail(
                        format!("frames[{i}].{key}"),
                        format!(
                            "has {count} entries, expected one for each of the {}",
                            counted(self.bodies.len(), "body")
                        ),
                    );
                }
            }
        }
        for (i, pair) in self.pairs.iter().enumerate() {
            for (k, &body) in pair.0.iter().enumerate() {
                if let Some(wrong) = out_of_range(body, self.bodies.len(), "body") {
                    return fail(format!("pairs[{i}][{k}]"), wrong);
                }
            }
        }
        if self.margin.0 < 0.0 {
            return fail("margin".into(), format!("is {}, expected at least 0", self.margin.0));
        }
        let margins = self.margins.as_deref().unwrap_or_default();
        if !margins.is_empty() && margins.len() != self.bodies.len() {
            let bodies = counted(self.bodies.len(), "body");
            let count = margins.len();
            return fail(
                "margins".into(),
                format!("has {count} entries, expected one for each of the {bodies}"),
            );
        }
        for (i, JsonNumber(margin)) in margins.iter().enumerate() {
            if !(0.0..=1e100).contains(margin) {
                return fail(format!("margins[{i}]"), format!("is {margin}, expected 0 to 1e100"));
            }
        }
        Ok(())
    }

    fn into_scene(self) -> SceneFile {
        let mut frames: Vec<Frame> = self
            .frames
            .into_iter()
            .map(|f| Frame {
                name: f.name,
                positions: f.positions.into_flattened(),
                rotations: f.rotations.into_flattened(),
            })
            .collect();
        if frames.is_empty() {
            frames.push(Frame {
                name: String::new(),
                positions: self.bodies.iter().flat_map(|b| b.position.numbers()).collect(),
                rotations: self.bodies.iter().flat_map(|b| b.rotation.numbers()).collect(),
            });
        }
        SceneFile {
            name: self.name,
            hulls: self.hulls,
            body_hulls: self.bodies.iter().map(|b| b.hull.0).collect(),
            body_names: self.bodies.into_iter().map(|b| b.name).collect(),
            frames,
            pairs: self.pairs.into_iter().flat_map(|pair| pair.0.map(|body| body.0)).collect(),
            margin: self.margin.0,
            margins: self.margins.unwrap_or_default().into_iter().map(|JsonNumber(margin)| margin).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: &str = r#"{"format": "hullcast.scene.v1", "name": "two", "margin": 0.5, "from": "a test",
        "hulls": [{"name": "t", "vertices": [[0,0,0],[1,0,0],[0,1,0],[0,0,1]], "volume_ratio": 1}],
        "bodies": [{"hull": 0, "position": [0,0,0], "rotation": [0,0,0,1]},
                   {"name": "b", "hull": 0, "position": [0,0,2], "rotation": [0,0,0,1]}],
        "frames": [{"name": "f", "positions": [[0,0,0],[0,0,3]], "rotations": [[0,0,0,1],[0,0,0,1]]}],
        "pairs": [[0,1]]}"#;

    // Catches a frame that is dropped, and poses taken from the bodies although the file has frames.
    #[test]
    fn frames_replace_the_bodies_poses() {
        let scene = SceneFile::parse(GOOD.as_bytes()).unwrap();
        assert_eq!((scene.frames.len(), scene.frames[0].positions[5], scene.margin), (1, 3.0, 0.5));
        let without = GOOD.replace("\"frames\"", "\"other\"");
        let scene = SceneFile::parse(without.as_bytes()).unwrap();
        assert_eq!((scene.frames.len(), scene.frames[0].positions[5]), (1, 2.0));
    }

    /// Catches margins of bodies that are dropped, and a file without them, as Python writes it, that is refused.
    #[test]
    fn bodies_have_margins() {
        for (margins, expected) in [("[0.25, 1]", vec![0.25, 1.0]), ("[]", vec![]), ("null", vec![])] {
            let text = GOOD.replacen("0.5,", &format!("0.5, \"margins\": {margins},"), 1);
            assert_eq!(SceneFile::parse(text.as_bytes()).unwrap().margins, expected);
        }
        assert_eq!(SceneFile::parse(GOOD.as_bytes()).unwrap().margins, [0.0; 0]);
    }

    /// Catches a default that is not sent, differs from the Python client's, or cannot be turned off.
    #[test]
    fn a_hull_without_a_planarity_has_the_clients_default() {
        let planarity = |hull: &str| {
            let text = GOOD.replacen("\"volume_ratio\": 1", hull, 1);
            SceneFile::parse(text.as_bytes()).unwrap().hulls[0].planarity
        };
        assert_eq!(planarity("\"volume_ratio\": 1"), Some(DEFAULT_PLANARITY));
        assert_eq!(planarity("\"planarity\": null"), None);
        assert_eq!(planarity("\"planarity\": 0.25"), Some(0.25), "its range is the server's to judge");
        let python = include_str!("../../../client/src/hullcast/_hulls.py");
        assert!(python.contains(&format!("\nDEFAULT_PLANARITY = {DEFAULT_PLANARITY:e}\n")));
    }

    /// Catches an error that does not name its place in a file of thousands of lines, or that does not say
    /// what is allowed there in the words of a user.
    #[test]
    fn errors_name_field_and_index() {
        let cases = [
            ("[0,0,1]]", "[0,0]]", "hulls[0].vertices[3]", "invalid length 2, expected 3 numbers"),
            ("[0,0,1]]", "[0,0,1,2,3]]", "hulls[0].vertices[3]", "invalid length 5, expected 3 numbers"),
            ("[0,0,1]]", "[0,0,true]]", "hulls[0].vertices[3][2]", "boolean `true`, expected a number"),
            ("[0,0,0,1]}", "[0,0,1]}", "bodies[0].rotation", "invalid length 3, expected 4 numbers"),
            (
                "\"hull\": 0, \"position\": [0,0,2]",
                "\"hull\": 7, \"position\": [0,0,2]",
                "bodies[1].hull",
                "is 7, expected 0: the scene has 1 hull",
            ),
            ("[[0,1]]", "[[0,1],[0,2]]", "pairs[1][1]", "is 2, expected 0 to 1: the scene has 2 bodies"),
            ("[[0,1]]", "[[0,1,1]]", "pairs[0]", "invalid length 3, expected 2 indices"),
            ("[[0,1]]", "[[0]]", "pairs[0]", "invalid length 1, expected 2 indices"),
            ("[[0,1]]", "[0,1]", "pairs[0]", "integer `0`, expected 2 indices"),
            ("[[0,1]]", "[[0,-1]]", "pairs[0][1]", "integer `-1`, expected an index, a whole number from 0"),
            ("[[0,1]]", "[[0,0.5]]", "pairs[0][1]", "`0.5`, expected an index, a whole number from 0"),
            ("[[0,1]]", "[[0,4294967296]]", "pairs[0][1]", "`4294967296`, expected an index"),
            ("[[0,0,0],[0,0,3]]", "[[0,0,0]]", "frames[0].positions", "has 1 entries, expected one for each"),
            ("[0,0,3]]", "[0,0,\"3\"]]", "frames[0].positions[1][2]", "string \"3\", expected a number"),
            ("0.5", "-0.5", "margin", "is -0.5, expected at least 0"),
            ("0.5,", "0.5, \"margins\": [1, -0.5],", "margins[1]", "is -0.5, expected 0 to 1e100"),
            ("0.5,", "0.5, \"margins\": [1e101, 0],", "margins[0]", "expected 0 to 1e100"),
            (
                "0.5,",
                "0.5, \"margins\": [1],",
                "margins",
                "has 1 entries, expected one for each of the 2 bodies",
            ),
            ("0.5,", "0.5, \"margins\": [1, null],", "margins[1]", "null, expected a number"),
            (
                "\"frames\": [",
                "\"frames\": [{\"name\": \"f\", \"positions\": [[0,0,0],[0,0,3]], \
                 \"rotations\": [[0,0,0,1],[0,0,0,1]]}, ",
                "frames[1].name",
                "frames[0] has the name \"f\" too",
            ),
            (FORMAT, "something", "format", "is \"something\", expected \"hullcast.scene.v1\""),
        ];
        for (from, to, place, allowed) in cases {
            let text = GOOD.replacen(from, to, 1);
            assert_ne!(text, GOOD, "{place}");
            let error = SceneFile::parse(text.as_bytes()).unwrap_err();
            assert_eq!(error.place, place, "{to}");
            assert!(error.message.contains(allowed), "{to}: {error}");
        }
        for text in [&b"{"[..], b"", b"# A page", format!("{GOOD} x").as_bytes()] {
            assert!(SceneFile::parse(text).unwrap_err().to_string().contains("not JSON ("));
        }
    }
}
