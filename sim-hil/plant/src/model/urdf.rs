//! The model as URDF, for programs that show robots: Foxglove, Lichtblick, Rerun, RViz.
//!
//! Links, masses, inertias and axes are those of [`links`](super::links). URDF has neither springs in hinges nor a law
//! of contact: who simulates takes [`mjcf`](super::mjcf). Each segment of a leg turns on two hinges, so between two
//! segments stands a link such as `fl0_bend`, of a mass that nothing can feel: simulators refuse one that moves without
//! any. Joints are named after their hinges, and `_joint`: many programs keep links and joints in one list of names.

use flix_host::pose::Pose;
use nalgebra::{Unit, UnitQuaternion, Vector3};

use super::links::{Hinge, LEAST_INERTIA, Link};
use super::xml::{escape, line, list};

/// Farthest bend or twist that is named as a limit, rad: legs have no stops, but URDF wants a number.
const HINGE_LIMIT: f64 = std::f64::consts::PI;

/// Mass of a link between two hinges, kg: 1e-9 of the lightest robot's. MuJoCo takes 1e-15 at the least.
const BETWEEN_MASS: f64 = 1e-10;

/// Least edge of a box that is drawn, m: MuJoCo takes none of size 0.
const LEAST_EDGE: f64 = 1e-4;

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
    let origin = origin(&link.center);
    let size = link.size.map(|edge| edge.max(LEAST_EDGE));
    let geometry = format!("<geometry><box size=\"{}\"/></geometry>", list(&size));
    let colour = list(&link.colour);
    for text in [
        inertial(&link.center, link.mass, link.inertia),
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

fn origin(at: &[f64; 3]) -> String {
    format!("<origin xyz=\"{}\"/>", list(at))
}

fn inertial(center: &[f64; 3], mass: f64, [x, y, z]: [f64; 3]) -> String {
    let inertia = format!("ixx=\"{x}\" ixy=\"0\" ixz=\"0\" iyy=\"{y}\" iyz=\"0\" izz=\"{z}\"");
    format!("<inertial>{}<mass value=\"{mass}\"/><inertia {inertia}/></inertial>", origin(center))
}

fn write_joint(out: &mut String, frame: &Frame) {
    if frame.is_between {
        line(out, 1, &format!("<link name=\"{}\">", frame.name));
        line(out, 2, &inertial(&[0.0; 3], BETWEEN_MASS, [LEAST_INERTIA; 3]));
        line(out, 1, "</link>");
    }
    let (name, kind) = match &frame.hinge {
        None => (&frame.name, "fixed"),
        Some(hinge) if hinge.spring.is_some() => (&hinge.name, "revolute"),
        Some(hinge) => (&hinge.name, "continuous"),
    };
    let name = format!("{name}_joint");
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

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::model::links::links;
    use crate::model::{NAMES, RobotModel};

    /// Returns what each element of this name is called, and what stands in it.
    fn elements<'a>(text: &'a str, element: &'a str) -> impl Iterator<Item = (&'a str, &'a str)> {
        let close = format!("</{element}>");
        let open = format!("<{element} name=\"");
        text.match_indices(&open)
            .map(|(at, open)| at + open.len())
            .collect::<Vec<_>>()
            .into_iter()
            .map(move |at| {
                let (name, rest) = text[at..].split_once('"').unwrap();
                (name, rest.split_once(close.as_str()).unwrap().0)
            })
    }

    #[test]
    fn no_name_stands_for_two_things_and_everything_has_a_mass() {
        for name in NAMES.into_iter().chain(["random-3", "stranger-5"]) {
            let model = RobotModel::named(name).unwrap();
            let text = urdf(name, &links(&model));
            let mut names = BTreeSet::new();
            let mut sum = 0.0;
            for (link, inside) in elements(&text, "link") {
                assert!(names.insert(link), "{name}: {link} twice");
                let values = |key: &str| {
                    let (_, rest) = inside.split_once(&format!("{key}=\"")).unwrap();
                    rest.split_once('"').unwrap().0.parse::<f64>().unwrap()
                };
                let moments = ["ixx", "iyy", "izz"].map(values);
                assert!(moments.iter().all(|it| *it >= LEAST_INERTIA), "{name}: {link}");
                sum += values("mass value");
                let edges = inside.split("size=\"").skip(1).flat_map(|it| {
                    it.split_once('"')
                        .unwrap()
                        .0
                        .split(' ')
                        .map(|edge| edge.parse::<f64>().unwrap())
                });
                assert!(edges.into_iter().all(|edge| edge > 0.0), "{name}: {link}");
            }
            for (joint, _) in elements(&text, "joint") {
                assert!(names.insert(joint), "{name}: {joint} twice");
            }
            let mass: f64 = links(&model).iter().map(|link| link.mass).sum();
            assert!((sum - mass).abs() < 1e-8 * mass, "{name}: {sum} kg of {mass}");
        }
    }
}
