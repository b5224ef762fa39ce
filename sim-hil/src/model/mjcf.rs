//! The model as MuJoCo's MJCF.
//!
//! Anyone can check this simulator with another, or go on there. Bodies, masses, hinges and contact are the
//! same, with MuJoCo's elliptic friction cone; the friction that holds a foot fast is not (MuJoCo's creeps). Rotors are driven by `motor`
//! actuators `top` and `bottom`, in N m about body +z.

use std::fmt::Write;

use crate::model::{Base, FootAxis, GRAVITY, LEG_SIDE, LEGS, Legs, RobotModel};

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
        &format!("<option timestep=\"{step}\" gravity=\"0 0 {}\" cone=\"elliptic\"/>", -GRAVITY),
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
    for name in ["top", "bottom"] {
        line(&mut out, 2, &format!("<motor name=\"{name}\" joint=\"{name}\"/>"));
    }
    line(&mut out, 1, "</actuator>");
    line(&mut out, 0, "</mujoco>");
    out
}

fn line(out: &mut String, depth: usize, text: &str) {
    // Writing to a string cannot fail.
    let _ = writeln!(out, "{:indent$}{text}", "", indent = 2 * depth);
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;")
}

/// Numbers in metres, in full precision.
fn list(values: &[f64]) -> String {
    let words: Vec<String> = values.iter().map(|v| format!("{v}")).collect();
    words.join(" ")
}

fn inertial(out: &mut String, depth: usize, mass: f64, at: [f64; 3], principal: [f64; 3]) {
    // MuJoCo refuses a body without any inertia; a point gets one that nothing can feel.
    let principal = principal.map(|i| i.max(1e-12));
    line(
        out,
        depth,
        &format!(
            "<inertial mass=\"{mass}\" pos=\"{}\" diaginertia=\"{}\"/>",
            list(&at),
            list(&principal)
        ),
    );
}

/// Principal inertia of a solid box, kg m^2.
fn box_inertia(mass: f64, size: [f64; 3]) -> [f64; 3] {
    let [a, b, c] = size.map(|s| s * s);
    [mass / 12.0 * (b + c), mass / 12.0 * (a + c), mass / 12.0 * (a + b)]
}

fn shown(out: &mut String, depth: usize, size: [f64; 3], at: [f64; 3], color: &str) {
    line(
        out,
        depth,
        &format!(
            "<geom type=\"box\" size=\"{}\" pos=\"{}\" rgba=\"{color}\" mass=\"0\" contype=\"0\" conaffinity=\"0\"/>",
            list(&size.map(|s| (0.5 * s).max(1e-4))),
            list(&at)
        ),
    );
}

/// The body, its fixed parts as bodies without joints, rotors and legs.
fn body(out: &mut String, model: &RobotModel, contact: [[f64; 2]; 4]) {
    let mm = |v: f64| 1e-3 * v;
    line(out, 2, &format!("<body name=\"body\" pos=\"0 0 {}\">", model.standing_height()));
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
    let p = &model.plate;
    let size = [mm(p.length_mm), mm(p.width_mm), mm(p.thickness_mm)];
    inertial(out, 3, mm(p.mass_g), [0.0; 3], box_inertia(mm(p.mass_g), size));
    shown(out, 3, size, [0.0; 3], "0.2 0.2 0.2 1");
    let c = &model.core;
    let core = [c.x_mm + model.body.offset_x_mm, model.body.offset_y_mm, c.z_mm];
    let (b, e) = (&model.battery, &model.electronics);
    let mut fixed = vec![
        ("battery".to_owned(), b.mass_g, [b.x_mm, b.y_mm, b.z_mm], b.size_mm),
        ("electronics".to_owned(), e.mass_g, [e.x_mm, e.y_mm, e.z_mm], e.size_mm),
        ("core".to_owned(), model.core_mass_g(), core, c.size_mm),
    ];
    for (i, load) in model.load.iter().enumerate() {
        fixed.push((format!("load{i}"), load.mass_g, [load.x_mm, load.y_mm, load.z_mm], [0.0; 3]));
    }
    for (name, mass_g, at, size) in fixed {
        if mass_g == 0.0 {
            continue;
        }
        let size = size.map(mm);
        line(out, 3, &format!("<body name=\"{name}\" pos=\"{}\">", list(&at.map(mm))));
        inertial(out, 4, mm(mass_g), [0.0; 3], box_inertia(mm(mass_g), size));
        shown(out, 4, size, [0.0; 3], "0.5 0.5 0.6 0.5");
        line(out, 3, "</body>");
    }
    rotors(out, model);
    if let Some(legs) = &model.legs {
        for (index, contact) in contact.into_iter().enumerate() {
            leg(out, model, legs, index, contact);
        }
    }
    line(out, 2, "</body>");
}

fn rotors(out: &mut String, model: &RobotModel) {
    let s = &model.shaker;
    for (name, sign) in [("top", 1.0), ("bottom", -1.0)] {
        let z = 1e-3 * (s.z_mm + sign * 0.5 * s.spacing_mm);
        line(out, 3, &format!("<body name=\"{name}\" pos=\"0 0 {z}\">"));
        line(out, 4, &format!("<joint name=\"{name}\" type=\"hinge\" axis=\"0 0 1\"/>"));
        let at = [1e-3 * s.arm_mm, 0.0, 0.0];
        // The bell's inertia is a part of the rotor, so that the body feels it too.
        let bell = 1e-7 * s.bell_inertia_g_cm2;
        inertial(out, 4, 1e-3 * s.mass_g, at, [0.5 * bell, 0.5 * bell, bell]);
        shown(out, 4, [8e-3; 3], at, "0.8 0.3 0.1 1");
        line(out, 3, "</body>");
    }
}

fn leg(out: &mut String, model: &RobotModel, legs: &Legs, index: usize, contact: [f64; 2]) {
    let own = legs.each()[index];
    let [sx, sy] = LEG_SIDE[index];
    let name = LEGS[index];
    let (sin, cos) = legs.hinge_deg.to_radians().sin_cos();
    let segment = 1e-3 * legs.length_mm / 3.0;
    let mass = 1e-3 * legs.mass_g / 3.0;
    let size = [1e-3 * legs.width_mm, segment, 1e-3 * legs.thickness_mm];
    let bend = (
        legs.bend_stiffness_n_m_rad * own.bend_stiffness_factor,
        legs.bend_damping_n_m_s_rad * own.bend_damping_factor,
    );
    let twist = (
        legs.twist_stiffness_n_m_rad * own.twist_stiffness_factor,
        legs.twist_damping_n_m_s_rad * own.twist_damping_factor,
    );
    for k in 0..3 {
        let angle = (own.twist_hand * legs.twist_deg[k]).to_radians();
        let (s, c) = angle.sin_cos();
        // Axes of this segment in those of the one above (the body for the first): x, then y.
        let place = if k == 0 {
            let root = [
                1e-3 * sx * legs.root_x_mm,
                1e-3 * sy * legs.root_y_mm,
                -0.5e-3 * model.plate.thickness_mm,
            ];
            let (hx, hy) = (cos, sy * sin);
            // Local z of the hinge frame is (-hy, hx, 0); twisting turns x towards -z.
            let x = [c * hx + s * hy, c * hy - s * hx, 0.0];
            format!("pos=\"{}\" xyaxes=\"{} 0 0 -1\"", list(&root), list(&x))
        } else {
            format!("pos=\"0 {segment} 0\" xyaxes=\"{} 0 {} 0 1 0\"", c, -s)
        };
        line(out, 3 + k, &format!("<body name=\"{name}{k}\" {place}>"));
        for (joint, axis, (stiffness, damping)) in
            [("bend", "1 0 0", bend), ("twist", "0 1 0", twist)]
        {
            line(
                out,
                4 + k,
                &format!(
                    "<joint name=\"{name}{k}_{joint}\" type=\"hinge\" axis=\"{axis}\" stiffness=\"{stiffness}\" damping=\"{damping}\"/>"
                ),
            );
        }
        let at = [0.0, 0.5 * segment, 0.0];
        inertial(out, 4 + k, mass, at, box_inertia(mass, size));
        shown(out, 4 + k, size, at, "0.2 0.5 0.8 1");
    }
    line(out, 6, &format!("<site name=\"{name}_tip\" pos=\"0 {segment} 0\" size=\"0.001\"/>"));
    foot(out, model, legs, index, contact);
    for k in (0..3).rev() {
        line(out, 3 + k, "</body>");
    }
}

/// The foot hangs level under the tip: its axes are the body's when the leg is straight.
fn foot(out: &mut String, model: &RobotModel, legs: &Legs, index: usize, contact: [f64; 2]) {
    let segment = 1e-3 * legs.length_mm / 3.0;
    let own = legs.each()[index];
    let [sx, sy] = LEG_SIDE[index];
    let foot = &legs.foot;
    let total: f64 = legs.twist_deg.iter().sum::<f64>() * own.twist_hand;
    let hinge = sy * legs.hinge_deg;
    // The last segment's x axis points along `heading` in the plane, counted from body x about z (up);
    // twisting about the beam (down) turns it backwards.
    let heading = (hinge - total).to_radians();
    let (s, c) = heading.sin_cos();
    // Body axes in segment axes: the segment has x = (c, s, 0), y = (0, 0, -1), z = (-s, c, 0).
    let (body_x, body_y) = ([c, 0.0, -s], [s, 0.0, c]);
    let shift = 1e-3 * own.foot_shift_mm;
    let (dx, dy) = match foot.axis {
        FootAxis::Across => (0.0, sy * shift),
        FootAxis::Along => (sx * shift, 0.0),
    };
    let height = 1e-3 * foot.height_mm;
    let at =
        [dx * body_x[0] + dy * body_y[0], segment + 0.5 * height, dx * body_x[2] + dy * body_y[2]];
    let (long, wide) = foot.size_xy_mm();
    let size = [1e-3 * long, 1e-3 * wide, height];
    let mass = 1e-3 * foot.mass_g;
    line(
        out,
        6,
        &format!(
            "<body name=\"{}_foot\" pos=\"{}\" xyaxes=\"{} {}\">",
            LEGS[index],
            list(&at),
            list(&body_x),
            list(&body_y)
        ),
    );
    inertial(out, 7, mass, [0.0; 3], box_inertia(mass, size));
    let k = &model.contact;
    line(
        out,
        7,
        &format!(
            "<geom name=\"{}_foot\" type=\"box\" size=\"{}\" mass=\"0\" contype=\"0\" conaffinity=\"1\" priority=\"1\" condim=\"6\" friction=\"{}\" solref=\"{}\" solimp=\"{} 0.5 2\" rgba=\"0.3 0.8 0.3 1\"/>",
            LEGS[index],
            list(&size.map(|v| 0.5 * v)),
            list(&[own.friction, 1e-3 * k.torsional_friction_mm, 1e-3 * k.rolling_friction_mm]),
            list(&contact),
            list(&[k.impedance_touch, k.impedance_full, 1e-3 * k.impedance_width_mm]),
        ),
    );
    line(out, 6, "</body>");
}
