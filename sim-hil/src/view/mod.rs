//! Looking at a run: a replay in the browser.
//!
//! A [`Recording`] is what moved, as data: boxes with their poses over time, arrows for forces, a
//! path to follow, captions. It becomes one HTML file that needs no network and nothing else: open
//! it, drag to turn, scroll to come closer, slow down until the rotors can be followed.
//!
//! A [`FrameView`] is the same for programs that know the robot by its URDF.
//!
//! Lengths in metres, forces in newtons, world frame ENU, quaternions `[w, x, y, z]`.

mod film;
mod frames;
mod shapes;

pub use film::Film;
pub use frames::FrameView;
pub use shapes::RobotView;

use std::path::{Path, PathBuf};

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use flix_host::pose::Pose;
use flix_host::teleop::page::scene::SCENE;
use serde::Serialize;

/// The page, with a place each for the title, the drawing and the data.
const PAGE: &str = include_str!("replay.html");

/// A box that moves as a rigid body.
#[derive(Debug, Clone, Serialize)]
pub struct Part {
    /// For people, for example `front left foot`.
    pub name: String,
    /// Half its edges along its own axes, metres.
    pub half_size: [f64; 3],
    /// Red, green, blue.
    pub colour: [u8; 3],
}

/// What a force arrow stands for.
#[derive(Debug, Clone, Serialize)]
pub struct Arrow {
    /// For the legend.
    pub name: String,
    /// Red, green, blue.
    pub colour: [u8; 3],
    /// Metres of arrow per newton.
    pub scale: f64,
}

/// Where a force acts and how strongly.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Force {
    /// Where it acts, metres.
    pub at: [f64; 3],
    /// Newtons.
    pub vector: [f64; 3],
}

/// One moment.
#[derive(Debug, Clone)]
pub struct Frame {
    /// Seconds since the start.
    pub time: f64,
    /// One for every [`Recording::parts`].
    pub poses: Vec<Pose>,
    /// One for every [`Recording::arrows`].
    pub forces: Vec<Force>,
}

/// A line of text that holds from a moment on: the mode, what happened.
#[derive(Debug, Clone, Serialize)]
pub struct Caption {
    /// Seconds since the start.
    pub time: f64,
    /// The text.
    pub text: String,
}

/// A run to look at.
#[derive(Debug, Clone, Default)]
pub struct Recording {
    /// Title of the page.
    pub title: String,
    /// What moves. The first is the body, which the view follows and whose trail is drawn.
    pub parts: Vec<Part>,
    /// What pushes.
    pub arrows: Vec<Arrow>,
    /// A path on the floor that was to be followed; may be empty.
    pub reference: Vec<[f64; 2]>,
    /// In order of time.
    pub captions: Vec<Caption>,
    /// In order of time.
    pub frames: Vec<Frame>,
}

#[derive(Serialize)]
struct Header<'a> {
    parts: &'a [Part],
    arrows: &'a [Arrow],
    reference: &'a [[f64; 2]],
    captions: &'a [Caption],
    frames: usize,
    /// Little-endian `f32`, Base64: per frame the time, 7 numbers a part, 6 numbers an arrow.
    data: String,
}

impl Recording {
    /// Writes the replay as one self-contained HTML document.
    ///
    /// # Errors
    /// When the recording has no frame, or one whose poses or forces do not match its parts and
    /// arrows.
    pub fn to_html(&self) -> Result<String, RecordingError> {
        if self.frames.is_empty() {
            return Err(RecordingError::Empty);
        }
        let header = Header {
            parts: &self.parts,
            arrows: &self.arrows,
            reference: &self.reference,
            captions: &self.captions,
            frames: self.frames.len(),
            data: STANDARD.encode(self.pack()?),
        };
        // `</script>` in a caption must not end the data; `<` has an escape in JSON strings.
        let json = serde_json::to_string(&header)?.replace('<', "\\u003c");
        let title = self.title.replace('&', "&amp;").replace('<', "&lt;");
        Ok(PAGE
            .replace("{{scene}}", SCENE)
            .replace("{{title}}", &title)
            .replace("{{recording}}", &json))
    }

    /// Writes the replay to a file, and returns its path.
    ///
    /// # Errors
    /// As [`Recording::to_html`], and when the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<PathBuf, RecordingError> {
        let html = self.to_html()?;
        path.parent()
            .map_or(Ok(()), std::fs::create_dir_all)
            .and_then(|()| flix_host::system::file::overwrite(path, html.as_bytes(), || ()))
            .map_err(|source| RecordingError::Write { path: path.to_owned(), source })?;
        Ok(path.to_owned())
    }

    fn pack(&self) -> Result<Vec<u8>, RecordingError> {
        let numbers = 1 + 7 * self.parts.len() + 6 * self.arrows.len();
        let mut bytes = Vec::with_capacity(self.frames.len() * numbers * 4);
        let mut push = |value: f64| bytes.extend_from_slice(&(value as f32).to_le_bytes());
        for (index, frame) in self.frames.iter().enumerate() {
            if frame.poses.len() != self.parts.len() || frame.forces.len() != self.arrows.len() {
                return Err(RecordingError::Mismatch { frame: index });
            }
            push(frame.time);
            for pose in &frame.poses {
                let (position, orientation) =
                    (pose.position.coordinates(), pose.orientation.components());
                position.into_iter().chain(orientation).for_each(&mut push);
            }
            for force in &frame.forces {
                force.at.into_iter().chain(force.vector).for_each(&mut push);
            }
        }
        Ok(bytes)
    }
}

/// Why a recording cannot be shown.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// Nothing was recorded.
    #[error("the recording has no frames: run for longer, or record more often")]
    Empty,
    /// A frame does not fit the rest.
    #[error("frame {frame} of the recording has another number of parts or arrows than the first")]
    Mismatch {
        /// Index of the frame.
        frame: usize,
    },
    /// The file could not be written.
    #[error("cannot write {}: {source}; check that the folder may be written to", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The data could not be written as JSON.
    #[error("the recording could not be encoded: {0}")]
    Encode(#[from] serde_json::Error),
}

#[cfg(test)]
mod tests {
    use flix_host::pose::Quaternion;

    use super::*;

    fn recording(caption: &str) -> Recording {
        Recording {
            title: "Turn <left>".into(),
            parts: vec![Part {
                name: "plate".into(),
                half_size: [0.11, 0.06, 0.002],
                colour: [60, 60, 70],
            }],
            arrows: vec![Arrow {
                name: "shaking force".into(),
                colour: [200, 30, 30],
                scale: 0.01,
            }],
            captions: vec![Caption { time: 0.0, text: caption.into() }],
            frames: vec![Frame {
                time: 0.5,
                poses: vec![Pose {
                    position: [1.0, 2.0, 3.0].into(),
                    orientation: Quaternion::about_z(0.0),
                }],
                forces: vec![Force { at: [0.0; 3], vector: [4.0, 5.0, 6.0] }],
            }],
            ..Recording::default()
        }
    }

    #[test]
    fn frames_are_packed_time_first_then_poses_then_forces() {
        let bytes = recording("").pack().unwrap();
        let numbers: Vec<f32> =
            bytes.chunks(4).map(|four| f32::from_le_bytes(four.try_into().unwrap())).collect();
        assert_eq!(numbers, [0.5, 1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 4.0, 5.0, 6.0]);
    }

    #[test]
    fn text_cannot_break_out_of_the_page() {
        let html = recording("</script><b>").to_html().unwrap();
        assert!(!html.contains("</script><b>") && html.contains("Turn &lt;left>"));
    }

    #[test]
    fn the_page_asks_for_nothing_from_elsewhere() {
        let html = recording("").to_html().unwrap();
        assert!(!html.contains("http") && !html.contains("{{"));
    }

    #[test]
    fn a_frame_with_a_missing_part_is_refused() {
        let mut broken = recording("");
        broken.frames[0].poses.clear();
        assert!(matches!(broken.to_html(), Err(RecordingError::Mismatch { frame: 0 })));
    }
}
