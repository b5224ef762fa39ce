//! The model as MuJoCo's MJCF.
//!
//! Anyone can check this simulator with another, or go on there. Bodies, masses, hinges and contact are the
//! same, with MuJoCo's elliptic friction cone; the friction that holds a foot fast is not (MuJoCo's creeps). Rotors are driven by `motor`
//! actuators `top` and `bottom`, in N m about body +z, up to the torque at the current limit; MuJoCo's rotors have neither friction nor
//! back-EMF. Sensors give the angles and speeds of the rotors, and the pose and the motion of the base; the keyframe `standing` is the
//! beginning.

use flix_firmware::settings::Settings;

use crate::model::links::{BASE_LINK, Link, links};
use crate::model::xml::{escape, line, list};
use crate::model::{Base, LEGS, RobotModel};

/// Time constants of contacts below so many steps MuJoCo raises without a word (`refsafe`).
const LEAST_STEPS: f64 = 2.0;

/// Returns a sentence about a step, s, with which MuJoCo would give the feet another floor than `contact`, as for [`mjcf`].
pub fn too_long(step: f64, contact: [[f64; 2]; 4]) -> Option<String> {
    let times = contact.map(|[time, _]| time).into_iter().filter(|time| *time > 0.0);
    let shortest = times.fold(f64::INFINITY, f64::min);
    (shortest < LEAST_STEPS * step).then(|| {
        format!(
            "MuJoCo takes no time constant of a contact shorter than two steps, and this floor's is {:.3} ms: choose a step of at most \
             {:.4} ms, or it will be another floor",
            1e3 * shortest,
            1e3 * shortest / LEAST_STEPS
        )
    })
}

/// Writes the model as MJCF with the given step in seconds and each foot's `solref`: time constant in s, damping ratio.
///
/// The model must have passed [`RobotModel::check`].
pub fn mjcf(model: &RobotModel, step: f64, contact: [[f64; 2]; 4]) -> String {
    let mut out = String::new();
    let floor = 0.0;
    line(&mut out, 0, &format!("<mujoco model=\"{}\">", escape(&model.name)));
    line(&mut out, 1, "<compiler angle=\"radian\" autolimits=\"true\"/>");
    line(
        &mut out,
        1,
        &format!(
            "<option timestep=\"{step}\" gravity=\"{}\" cone=\"elliptic\"/>",
            list(&model.gravity())
        ),
    );
    line(&mut out, 1, "<worldbody>");
    line(&mut out, 2, "<light pos=\"0 0 1\"/>");
    line(
        &mut out,
        2,
        &format!(
            "<geom name=\"floor\" type=\"plane\" pos=\"0 0 {floor}\" size=\"5 5 0.1\" contype=\"1\" conaffinity=\"0\"/>"
        ),
    );
    body(&mut out, model, contact);
    line(&mut out, 1, "</worldbody>");
    line(&mut out, 1, "<actuator>");
    let most = largest_torque(model);
    for name in ROTORS {
        let range = format!("ctrlrange=\"-{most} {most}\"");
        line(&mut out, 2, &format!("<motor name=\"{name}\" joint=\"{name}\" {range}/>"));
    }
    line(&mut out, 1, "</actuator>");
    line(&mut out, 1, "<sensor>");
    for name in ROTORS {
        for (quantity, element) in [("angle", "jointpos"), ("speed", "jointvel")] {
            let sensor = format!("<{element} name=\"{name}_{quantity}\" joint=\"{name}\"/>");
            line(&mut out, 2, &sensor);
        }
    }
    for (name, element) in [
        ("position", "framepos"),
        ("orientation", "framequat"),
        ("velocity", "framelinvel"),
        ("turn_rate", "frameangvel"),
    ] {
        let sensor =
            format!("<{element} name=\"{name}\" objtype=\"xbody\" objname=\"{BASE_LINK}\"/>");
        line(&mut out, 2, &sensor);
    }
    line(&mut out, 1, "</sensor>");
    line(&mut out, 1, "<keyframe>");
    let key = format!("<key name=\"standing\" qpos=\"{}\"/>", list(&standing(model)));
    line(&mut out, 2, &key);
    line(&mut out, 1, "</keyframe>");
    line(&mut out, 0, "</mujoco>");
    out
}

/// Joints of the rotors.
const ROTORS: [&str; 2] = ["top", "bottom"];

/// Returns the torque of a motor at the current limit of the robot's settings, N m.
fn largest_torque(model: &RobotModel) -> f64 {
    let electrical = &model.electrical;
    let settings = electrical.stored_settings().ok().flatten().unwrap_or(Settings::DEFAULT);
    let linked = 1e-3 * electrical.motor.flux_linkage_mwb * f64::from(electrical.motor.pole_pairs);
    1.5 * linked * f64::from(settings.current_limit)
}

/// Returns the coordinates of a robot that stands: those of a free base, then of all other joints, which are zero.
fn standing(model: &RobotModel) -> Vec<f64> {
    let base = match model.base {
        Base::Fixed {} => vec![],
        Base::Planar { .. } => vec![0.0; 3],
        Base::Free {} => vec![0.0, 0.0, model.standing_height(), 1.0, 0.0, 0.0, 0.0],
    };
    let hinges = links(model).iter().map(|link| link.hinges.len()).sum();
    base.into_iter().chain(std::iter::repeat_n(0.0, hinges)).collect()
}

/// The body and all that it carries: fixed parts as bodies without joints, rotors and legs.
fn body(out: &mut String, model: &RobotModel, contact: [[f64; 2]; 4]) {
    let links = links(model);
    line(out, 2, &format!("<body name=\"{BASE_LINK}\" pos=\"0 0 {}\">", model.standing_height()));
    match model.base {
        Base::Fixed {} => {}
        Base::Planar { damping_n_s_m, yaw_damping_n_m_s } => {
            for (name, kind, axis, damping) in [
                ("x", "slide", "1 0 0", damping_n_s_m),
                ("y", "slide", "0 1 0", damping_n_s_m),
                ("yaw", "hinge", "0 0 1", yaw_damping_n_m_s),
            ] {
                line(
                    out,
                    3,
                    &format!(
                        "<joint name=\"{name}\" type=\"{kind}\" axis=\"{axis}\" damping=\"{damping}\"/>"
                    ),
                );
            }
        }
        Base::Free {} => line(out, 3, "<freejoint name=\"free\"/>"),
    }
    inside(out, 3, model, &links, 0, contact);
    line(out, 2, "</body>");
}

/// What is inside a body's element: its mass and shape, then the bodies that it carries.
fn inside(
    out: &mut String,
    depth: usize,
    model: &RobotModel,
    links: &[Link],
    index: usize,
    contact: [[f64; 2]; 4],
) {
    let link = &links[index];
    line(
        out,
        depth,
        &format!(
            "<inertial mass=\"{}\" pos=\"{}\" diaginertia=\"{}\"/>",
            link.mass,
            list(&link.center),
            list(&link.inertia)
        ),
    );
    line(out, depth, &shape(model, link, contact));
    let carried = |child: &usize| links[*child].parent == Some(index);
    for child in (0..links.len()).filter(carried) {
        let link = &links[child];
        if let Some(leg) = link.foot_of {
            let tip = list(&[0.0, link.at[1] - 0.5 * link.size[2], 0.0]);
            line(
                out,
                depth,
                &format!("<site name=\"{}_tip\" pos=\"{tip}\" size=\"0.001\"/>", LEGS[leg]),
            );
        }
        let axes = link
            .axes
            .map_or_else(String::new, |axes| format!(" xyaxes=\"{}\"", list(axes.as_flattened())));
        line(
            out,
            depth,
            &format!("<body name=\"{}\" pos=\"{}\"{axes}>", link.name, list(&link.at)),
        );
        for hinge in &link.hinges {
            let spring = hinge.spring.map_or_else(String::new, |[stiffness, damping]| {
                format!(" stiffness=\"{stiffness}\" damping=\"{damping}\"")
            });
            line(
                out,
                depth + 1,
                &format!(
                    "<joint name=\"{}\" type=\"hinge\" axis=\"{}\"{spring}/>",
                    hinge.name,
                    list(&hinge.axis)
                ),
            );
        }
        inside(out, depth + 1, model, links, child, contact);
        line(out, depth, "</body>");
    }
}

/// The box of a link: a foot touches the floor, all else is only drawn.
fn shape(model: &RobotModel, link: &Link, contact: [[f64; 2]; 4]) -> String {
    let half = |least: f64| list(&link.size.map(|edge| (0.5 * edge).max(least)));
    let colour = list(&link.colour);
    match (link.foot_of, &model.legs) {
        (Some(leg), Some(legs)) => {
            let k = &model.contact;
            let friction = legs.each()[leg].friction;
            format!(
                "<geom name=\"{}\" type=\"box\" size=\"{}\" mass=\"0\" contype=\"0\" conaffinity=\"1\" priority=\"1\" condim=\"6\" friction=\"{}\" solref=\"{}\" solimp=\"{} 0.5 2\" rgba=\"{colour}\"/>",
                link.name,
                half(0.0),
                list(&[friction, 1e-3 * k.torsional_friction_mm, 1e-3 * k.rolling_friction_mm]),
                list(&contact[leg]),
                list(&[k.impedance_touch, k.impedance_full, 1e-3 * k.impedance_width_mm]),
            )
        }
        _ => format!(
            "<geom type=\"box\" size=\"{}\" pos=\"{}\" rgba=\"{colour}\" mass=\"0\" contype=\"0\" conaffinity=\"0\"/>",
            half(1e-4),
            list(&link.center)
        ),
    }
}
