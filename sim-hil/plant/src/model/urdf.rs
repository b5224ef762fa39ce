//! The model as URDF, for programs that show robots: Foxglove, Lichtblick, Rerun, RViz.
//!
//! Links, masses, inertias and axes are those of [`links`](super::links). URDF has neither springs in hinges nor a law
//! of contact: who simulates takes [`mjcf`](super::mjcf). Each segment of a leg turns on two hinges, so between two
//! segments stands a link without mass, such as `fl0_bend`.

use flix_host::pose::Pose;
use nalgebra::{Unit, UnitQuaternion, Vector3};

use super::links::{Hinge, Link};
use super::xml::{escape, line, list};

/// Farthest bend or twist that is named as a limit, rad: legs have no stops, but URDF wants a number.
const HINGE_LIMIT: f64 = std::f64::consts::PI;

/// Largest torque, N m, and speed, rad/s, that are named: URDF wants these, too.
const MOST: f64 = 1000.0;

/// A frame on the one that carries it, which it turns against by one hinge at most.
#[derive(Debug, Clone)]
pub struct Frame {
    /// Its name, which is that of its link.
    pub name: String,
    /// Name of the frame that carries it.
    pub parent: String,
    hinge: Option<Hinge>,
    at: Vector3<f64>,
    turned: UnitQuaternion<f64>,
    /// Does it carry the next hinge alone, and no link of the robot?
    is_between: bool,
}

impl Frame {
    /// Returns its pose in the axes of its parent with its hinge turned by `angle`, rad.
    fn pose(&self, angle: f64) -> Pose {
        let axis = self.hinge.as_ref().map_or(Vector3::z(), |hinge| hinge.axis.into());
        let turned =
            self.turned * UnitQuaternion::from_axis_angle(&Unit::new_normalize(axis), angle);
        Pose {
            position: <[f64; 3]>::from(self.at).into(),
            orientation: [turned.w, turned.i, turned.j, turned.k].into(),
        }
    }
}

/// Returns all frames but the body's, each after the one that carries it.
pub fn frames(links: &[Link]) -> Vec<Frame> {
    let mut frames = Vec::new();
    for link in links {
        let Some(parent) = link.parent else { continue };
        let mut carrier = links[parent].name.clone();
        let (mut at, mut turned) = (Vector3::from(link.at), link.orientation());
        let count = link.hinges.len();
        for hinge in link.hinges.iter().take(count.saturating_sub(1)) {
            let name = hinge.name.clone();
            let hinge = Some(hinge.clone());
            frames.push(Frame {
                name: name.clone(),
                parent: carrier,
                hinge,
                at,
                turned,
                is_between: true,
            });
            (carrier, at, turned) = (name, Vector3::zeros(), UnitQuaternion::identity());
        }
        let hinge = link.hinges.last().cloned();
        frames.push(Frame {
            name: link.name.clone(),
            parent: carrier,
            hinge,
            at,
            turned,
            is_between: false,
        });
    }
    frames
}

/// Returns the pose of each frame on its parent. `angles`: of all hinges, rad, in the order of the frames.
pub fn poses(
    frames: &[Frame],
    angles: impl IntoIterator<Item = f64>,
) -> impl Iterator<Item = (&Frame, Pose)> {
    let mut angles = angles.into_iter();
    frames.iter().map(move |frame| {
        let angle = frame.hinge.as_ref().and_then(|_| angles.next());
        (frame, frame.pose(angle.unwrap_or(0.0)))
    })
}

/// Writes the links of a model as URDF. `name`: of the robot.
pub fn urdf(name: &str, links: &[Link]) -> String {
    let mut out = String::new();
    line(&mut out, 0, "<?xml version=\"1.0\"?>");
    line(&mut out, 0, &format!("<robot name=\"{}\">", escape(name)));
    for link in links {
        write_link(&mut out, link);
    }
    for frame in frames(links) {
        write_joint(&mut out, &frame);
    }
    line(&mut out, 0, "</robot>");
    out
}

fn write_link(out: &mut String, link: &Link) {
    line(out, 1, &format!("<link name=\"{}\">", link.name));
    let origin = format!("<origin xyz=\"{}\"/>", list(&link.center));
    let [x, y, z] = link.inertia;
    let geometry = format!("<geometry><box size=\"{}\"/></geometry>", list(&link.size));
    let colour = list(&link.colour);
    for text in [
        format!(
            "<inertial>{origin}<mass value=\"{}\"/><inertia ixx=\"{x}\" ixy=\"0\" ixz=\"0\" iyy=\"{y}\" iyz=\"0\" izz=\"{z}\"/></inertial>",
            link.mass
        ),
        format!(
            "<visual>{origin}{geometry}<material name=\"{}\"><color rgba=\"{colour}\"/></material></visual>",
            link.name
        ),
    ] {
        line(out, 2, &text);
    }
    if link.foot_of.is_some() {
        line(out, 2, &format!("<collision>{origin}{geometry}</collision>"));
    }
    line(out, 1, "</link>");
}

fn write_joint(out: &mut String, frame: &Frame) {
    if frame.is_between {
        line(out, 1, &format!("<link name=\"{}\"/>", frame.name));
    }
    let (name, kind) = match &frame.hinge {
        None => (format!("{}_fixed", frame.name), "fixed"),
        Some(hinge) if hinge.spring.is_some() => (hinge.name.clone(), "revolute"),
        Some(hinge) => (hinge.name.clone(), "continuous"),
    };
    line(out, 1, &format!("<joint name=\"{name}\" type=\"{kind}\">"));
    let (roll, pitch, yaw) = frame.turned.euler_angles();
    line(out, 2, &format!("<parent link=\"{}\"/>", frame.parent));
    line(out, 2, &format!("<child link=\"{}\"/>", frame.name));
    let [at, turned] = [list(frame.at.as_slice()), list(&[roll, pitch, yaw])];
    line(out, 2, &format!("<origin xyz=\"{at}\" rpy=\"{turned}\"/>"));
    if let Some(hinge) = &frame.hinge {
        line(out, 2, &format!("<axis xyz=\"{}\"/>", list(&hinge.axis)));
        if let Some([_, damping]) = hinge.spring {
            let limit = format!("lower=\"-{HINGE_LIMIT}\" upper=\"{HINGE_LIMIT}\"");
            line(out, 2, &format!("<limit {limit} effort=\"{MOST}\" velocity=\"{MOST}\"/>"));
            line(out, 2, &format!("<dynamics damping=\"{damping}\"/>"));
        }
    }
    line(out, 1, "</joint>");
}
