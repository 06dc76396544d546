//! The scene file of a command, with the exit codes of its faults, and the configuration that an option
//! names.

pub(crate) use hullcast_batch::scene_file::{
    Frame, HullPoints, SceneFile, SceneFileError, shown, unusable_poses,
};

use super::Error;
use super::exit::Exit;
use super::values::did_you_mean;

/// Fails if a pose of any configuration is unusable, because its pairs would be INVALID.
///
/// # Errors
/// The error names the configuration, and the number and the indices of the bodies with such poses.
pub(crate) fn check_poses(scene: &SceneFile) -> Result<(), Error> {
    scene.check_poses().map_err(|unusable| Exit::Unanswered.error(unusable))
}

/// The configuration of this name, or of this number.
///
/// # Errors
/// There is no such configuration; the message names the existing ones.
pub(crate) fn frame_named<'a>(scene: &'a SceneFile, wanted: &str) -> Result<&'a Frame, String> {
    const SHOWN: usize = 8;
    if let Some(frame) = scene.frames.iter().find(|frame| !frame.name.is_empty() && frame.name == wanted) {
        return Ok(frame);
    }
    if let Some(frame) = wanted.parse().ok().and_then(|index: usize| scene.frames.get(index)) {
        return Ok(frame);
    }
    let last = scene.frames.len() - 1;
    let names = scene.frames.iter().map(|frame| frame.name.as_str()).filter(|name| !name.is_empty());
    let mut shown: Vec<&str> = names.clone().take(SHOWN).collect();
    if names.clone().count() > SHOWN {
        shown.push("...");
    }
    let by_number = if last == 0 { "0".into() } else { format!("0 to {last}") };
    let allowed = match shown.is_empty() {
        true => by_number,
        false => format!("{by_number}, or a name: {}", shown.join(", ")),
    };
    Err(format!(
        "--frame {wanted}: {} has no such configuration; expected {allowed}{}",
        scene.name,
        did_you_mean(wanted, names)
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches a configuration that is found only by its number, or not at all, and a message that does
    /// not list the existing ones.
    #[test]
    fn frames_have_names_and_numbers() {
        let frame = |name: &str, height: f64| Frame {
            name: name.into(),
            positions: vec![0.0, 0.0, height],
            rotations: vec![0.0, 0.0, 0.0, 1.0],
        };
        let scene = SceneFile {
            name: "one".into(),
            hulls: Vec::new(),
            body_hulls: vec![0],
            body_names: vec![String::new()],
            frames: vec![frame("f", 3.0), frame("1", 4.0)],
            pairs: Vec::new(),
            margin: 0.0,
            margins: Vec::new(),
        };
        let height = |wanted: &str| frame_named(&scene, wanted).map(|frame| frame.positions[2]);
        for (wanted, expected) in [("f", 3.0), ("0", 3.0), ("1", 4.0)] {
            assert_eq!(height(wanted), Ok(expected), "{wanted}");
        }
        for wrong in ["2", "-1", "", "F1", "1.0"] {
            let error = height(wrong).unwrap_err();
            assert!(error.starts_with(&format!("--frame {wrong}: ")), "{error}");
            assert!(error.contains("expected 0 to 1, or a name: f, 1"), "{error}");
        }
    }
}
