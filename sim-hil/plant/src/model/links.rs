//! The model as a tree of rigid links on hinges: what other programs' formats of robots are written from.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use crate::model::{FootAxis, LEG_SIDE, LEGS, Legs, RobotModel};

/// A rigid link.
#[derive(Debug, Clone)]
pub struct Link {
    /// Its name: `fl0`.
    pub name: String,
    /// Index of the link that carries it, which stands before it; none for the body.
    pub parent: Option<usize>,
    /// Where its origin is in the axes of its parent while its hinges are straight, m.
    pub at: [f64; 3],
    /// Its x and y axes in those of its parent, where they differ.
    pub axes: Option<[[f64; 3]; 2]>,
    /// Its hinges, all at its origin; the first one turns the others.
    pub hinges: Vec<Hinge>,
    /// Mass, kg.
    pub mass: f64,
    /// Where the centre of its mass is, and of the box that is drawn, m.
    pub center: [f64; 3],
    /// Moments of inertia about the centre along its axes, kg m^2. Other programs refuse a mass without any: a point
    /// gets some that nothing can feel.
    pub inertia: [f64; 3],
    /// The box that is drawn, m.
    pub size: [f64; 3],
    /// Red, green, blue and opacity, 0 to 1.
    pub colour: [f64; 4],
    /// The leg whose foot it is.
    pub foot_of: Option<usize>,
}

/// A hinge.
#[derive(Debug, Clone)]
pub struct Hinge {
    /// Its name: `fl0_bend`.
    pub name: String,
    /// Its axis in those of the link.
    pub axis: [f64; 3],
    /// Stiffness, N m/rad, and damping, N m s/rad; none for a rotor, which turns freely.
    pub spring: Option<[f64; 2]>,
}

impl Link {
    /// Returns its orientation in the axes of its parent while its hinges are straight.
    pub fn orientation(&self) -> UnitQuaternion<f64> {
        let [x, y] = self.axes.unwrap_or([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
        let z = Vector3::from(x).cross(&Vector3::from(y));
        orientation([x, y, z.into()])
    }
}

/// Returns the rotation into a right-handed frame of these unit vectors.
pub fn orientation(axes: [[f64; 3]; 3]) -> UnitQuaternion<f64> {
    let matrix = Matrix3::from_columns(&axes.map(Vector3::from));
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix))
}

/// Name of the link that carries all others (REP 105).
pub const BASE_LINK: &str = "base_link";

const PLATE: [f64; 4] = [0.2, 0.2, 0.2, 1.0];
const LOAD: [f64; 4] = [0.5, 0.5, 0.6, 0.5];
const ROTOR: [f64; 4] = [0.8, 0.3, 0.1, 1.0];
const BEAM: [f64; 4] = [0.2, 0.5, 0.8, 1.0];
const FOOT: [f64; 4] = [0.3, 0.8, 0.3, 1.0];

/// Returns the links: the body first, each before those that it carries. Angles of 0 are straight legs, and rotors
/// that point forward.
///
/// The model must have passed [`RobotModel::check`].
pub fn links(model: &RobotModel) -> Vec<Link> {
    let plate = &model.plate;
    let size = [plate.length_mm, plate.width_mm, plate.thickness_mm].map(metres);
    let mut links = vec![Link {
        name: BASE_LINK.into(),
        parent: None,
        colour: PLATE,
        ..solid(metres(plate.mass_g), size, [0.0; 3])
    }];
    links.extend(fixed(model));
    links.extend(rotors(model));
    if let Some(legs) = &model.legs {
        for index in 0..LEGS.len() {
            leg(&mut links, model, legs, index);
        }
    }
    links
}

/// Least moment of inertia, kg m^2.
pub(super) const LEAST_INERTIA: f64 = 1e-12;

/// From mm to m, and from g to kg.
fn metres(millimetres: f64) -> f64 {
    1e-3 * millimetres
}

/// A solid box on the body.
fn solid(mass: f64, size: [f64; 3], center: [f64; 3]) -> Link {
    let [a, b, c] = size.map(|edge| edge * edge);
    Link {
        name: String::new(),
        parent: Some(0),
        at: [0.0; 3],
        axes: None,
        hinges: Vec::new(),
        mass,
        center,
        inertia: [b + c, a + c, a + b].map(|edges| (mass / 12.0 * edges).max(LEAST_INERTIA)),
        size,
        colour: LOAD,
        foot_of: None,
    }
}

fn fixed(model: &RobotModel) -> impl Iterator<Item = Link> {
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
    fixed.into_iter().filter(|(_, mass_g, ..)| *mass_g != 0.0).map(|(name, mass_g, at, size)| {
        Link { name, at: at.map(metres), ..solid(metres(mass_g), size.map(metres), [0.0; 3]) }
    })
}

fn rotors(model: &RobotModel) -> [Link; 2] {
    let s = &model.shaker;
    // The bell's inertia is a part of the rotor, so that the body feels it too.
    let bell = 1e-7 * s.bell_inertia_g_cm2;
    [("top", 1.0), ("bottom", -1.0)].map(|(name, sign)| Link {
        name: name.into(),
        at: [0.0, 0.0, 1e-3 * (s.z_mm + sign * 0.5 * s.spacing_mm)],
        hinges: vec![Hinge { name: name.into(), axis: [0.0, 0.0, 1.0], spring: None }],
        inertia: [0.5 * bell, 0.5 * bell, bell].map(|i| i.max(LEAST_INERTIA)),
        colour: ROTOR,
        ..solid(metres(s.mass_g), [8e-3; 3], [metres(s.arm_mm), 0.0, 0.0])
    })
}

/// Three segments and the foot.
fn leg(links: &mut Vec<Link>, model: &RobotModel, legs: &Legs, index: usize) {
    let own = legs.each()[index];
    let [sx, sy] = LEG_SIDE[index];
    let name = LEGS[index];
    let (sin, cos) = legs.hinge_deg.to_radians().sin_cos();
    let segment = metres(legs.length_mm) / 3.0;
    let mass = metres(legs.mass_g) / 3.0;
    let size = [metres(legs.width_mm), segment, metres(legs.thickness_mm)];
    let bend = [
        legs.bend_stiffness_n_m_rad * own.bend_stiffness_factor,
        legs.bend_damping_n_m_s_rad * own.bend_damping_factor,
    ];
    let twist = [
        legs.twist_stiffness_n_m_rad * own.twist_stiffness_factor,
        legs.twist_damping_n_m_s_rad * own.twist_damping_factor,
    ];
    for k in 0..3 {
        let angle = (own.twist_hand * legs.twist_deg[k]).to_radians();
        let (s, c) = angle.sin_cos();
        let (at, axes) = if k == 0 {
            let root = [
                1e-3 * sx * legs.root_x_mm,
                1e-3 * sy * legs.root_y_mm,
                -0.5e-3 * model.plate.thickness_mm,
            ];
            let (hx, hy) = (cos, sy * sin);
            // Local z of the hinge frame is (-hy, hx, 0); twisting turns x towards -z.
            (root, [[c * hx + s * hy, c * hy - s * hx, 0.0], [0.0, 0.0, -1.0]])
        } else {
            ([0.0, segment, 0.0], [[c, 0.0, -s], [0.0, 1.0, 0.0]])
        };
        let hinge = |kind, axis, spring| Hinge {
            name: format!("{name}{k}_{kind}"),
            axis,
            spring: Some(spring),
        };
        links.push(Link {
            name: format!("{name}{k}"),
            parent: Some(if k == 0 { 0 } else { links.len() - 1 }),
            at,
            axes: Some(axes),
            hinges: vec![
                hinge("bend", [1.0, 0.0, 0.0], bend),
                hinge("twist", [0.0, 1.0, 0.0], twist),
            ],
            colour: BEAM,
            ..solid(mass, size, [0.0, 0.5 * segment, 0.0])
        });
    }
    links.push(foot(legs, index, links.len() - 1));
}

/// The foot hangs level under the tip: its axes are the body's when the leg is straight.
fn foot(legs: &Legs, index: usize, segment: usize) -> Link {
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
    let shift = metres(own.foot_shift_mm);
    let (dx, dy) = match foot.axis {
        FootAxis::Across => (0.0, sy * shift),
        FootAxis::Along => (sx * shift, 0.0),
    };
    let height = metres(foot.height_mm);
    let (long, wide) = foot.size_xy_mm();
    Link {
        name: format!("{}_foot", LEGS[index]),
        parent: Some(segment),
        at: [
            dx * body_x[0] + dy * body_y[0],
            metres(legs.length_mm) / 3.0 + 0.5 * height,
            dx * body_x[2] + dy * body_y[2],
        ],
        axes: Some([body_x, body_y]),
        colour: FOOT,
        foot_of: Some(index),
        ..solid(metres(foot.mass_g), [metres(long), metres(wide), height], [0.0; 3])
    }
}
