//! Paths on the floor, measured by arc length.
//!
//! A path is a chain of poses at most [`SPACING`] apart, each facing along the path. A place on it
//! is its arc length in metres from the start; on a closed path the arc length continues to grow
//! lap after lap.

use crate::pose::geometry::{Area, PlanarPose, Position, wrap};

/// Largest distance between two neighbouring points, m: a fortieth of the robot's length.
pub const SPACING: f64 = 0.005;

/// Length of a path around a tip on which both branches are looked at, m: half of it before the tip.
const TIP: f64 = 0.04;
/// Change of the course within a spacing that makes a corner, rad: seven times that of the tightest bend of a figure eight.
const CORNER: f64 = 0.3;
/// Change of the course that makes a tip, rad (120 degrees).
const TURNS_BACK: f64 = 2.0 * std::f64::consts::FRAC_PI_3;
/// Difference of distances below which places are equally near, m: half the spacing.
const ALIKE: f64 = 0.5 * SPACING;

/// Ends of a list of waypoints that are no farther apart close the path, m: a robot that is so near to its path has joined it.
const CLOSED_WITHIN: f64 = 0.05;
/// Largest share of the length by which the ends of a closed path are apart.
const OPEN_SHARE: f64 = 0.1;

/// Longest path, m: a wrong unit must not fill the memory.
const LONGEST: f64 = 10_000.0;

/// The projection of a position onto a path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Projection {
    /// Arc length of the nearest point of the path, m.
    pub arc_length: f64,
    /// Distance from it, m, positive when the position is left of the path.
    pub error: f64,
    /// Direction of travel there, rad counter-clockwise from x.
    pub tangent: f64,
}

/// A path to follow.
#[derive(Debug, Clone, PartialEq)]
pub struct Path {
    name: String,
    points: Vec<PlanarPose>,
    /// Change of the course from each point to the next one, rad.
    bends: Vec<f64>,
    spacing: f64,
    closed: bool,
}

/// Why a path was refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PathError {
    /// A size out of range.
    #[error("{what} of {value} m is not a size: give a number from 0.01 to 100 m")]
    Size {
        /// The name of the measure.
        what: &'static str,
        /// The refused value, m.
        value: f64,
    },
    /// Fewer than two different points.
    #[error("a path needs at least two points apart from each other; this one has {0}")]
    TooFewPoints(usize),
    /// Longer than 10 km.
    #[error("the path is {0:.0} m long: give the points in metres")]
    TooLong(f64),
    /// A line without a point.
    #[error("line {line} (\"{text}\") is not a point: write x,y in metres, such as 0.5,-0.25")]
    NotAPoint {
        /// Number of the line, from 1.
        line: usize,
        /// Text of the line.
        text: String,
    },
}

impl Path {
    /// Makes a figure eight (lemniscate of Gerono) around the origin, `width` along x and `height`
    /// along y, m. It starts in the middle, towards +x and +y.
    ///
    /// # Errors
    /// When a size is not from 0.01 to 100 m.
    pub fn figure_eight(width: f64, height: f64) -> Result<Self, PathError> {
        let (a, b) = (size("a width", width)? / 2.0, size("a height", height)? / 2.0);
        Self::sampled("figure eight", move |t| Position::new(a * t.sin(), b * (2.0 * t).sin()))
    }

    /// Makes a circle around the origin, counter-clockwise from (radius, 0), m.
    ///
    /// # Errors
    /// When the radius is not from 0.01 to 100 m.
    pub fn circle(radius: f64) -> Result<Self, PathError> {
        let radius = size("a radius", radius)?;
        Self::sampled("circle", move |t| Position::new(radius * t.cos(), radius * t.sin()))
    }

    /// Makes a square around the origin, counter-clockwise from the middle of its right side, m.
    ///
    /// # Errors
    /// When the side is not from 0.01 to 100 m.
    pub fn square(side: f64) -> Result<Self, PathError> {
        let h = size("a side", side)? / 2.0;
        let corners = [(h, 0.0), (h, h), (-h, h), (-h, -h), (h, -h)];
        Self::through("square", &corners.map(|(x, y)| Position::new(x, y)), true)
    }

    /// Makes a path of straight lines between corners; `closed` returns from the last to the first.
    ///
    /// # Errors
    /// When fewer than two points differ, one is not a number, or the path is over 10 km.
    pub fn through(name: &str, corners: &[Position], closed: bool) -> Result<Self, PathError> {
        if let Some(bad) = corners.iter().find(|p| !p.is_finite()) {
            let text = format!("{},{}", bad.x, bad.y);
            return Err(PathError::NotAPoint { line: 0, text });
        }
        let mut chain = corners.to_vec();
        if closed {
            chain.extend(corners.first().copied());
        }
        chain.dedup_by(|a, b| a.distance_to(*b) < 1e-9);
        if chain.len() < 2 {
            return Err(PathError::TooFewPoints(chain.len()));
        }
        Self::resampled(name, &chain, closed)
    }

    /// Reads waypoints from a text: one `x,y` per line in metres (comma, semicolon or blanks
    /// between). Empty lines, `#` comments and one heading line are allowed. A last point within 50 mm of
    /// the first closes the path.
    ///
    /// # Errors
    /// When a line is not a point, or as for [`Path::through`].
    pub fn from_text(name: &str, text: &str) -> Result<Self, PathError> {
        let mut points = Vec::new();
        // Spreadsheets begin their text files with a byte-order mark.
        let meaningful =
            text.trim_start_matches('\u{feff}').lines().enumerate().map(|(number, line)| {
                (number + 1, line.split('#').next().unwrap_or_default().trim())
            });
        for (index, (line, content)) in meaningful.filter(|(_, l)| !l.is_empty()).enumerate() {
            match point(content) {
                Some(point) => points.push(point),
                // The first line may name the columns.
                None if index == 0 && content.chars().any(char::is_alphabetic) => {}
                None => return Err(PathError::NotAPoint { line, text: content.to_owned() }),
            }
        }
        let length: f64 = points.windows(2).map(|ends| ends[0].distance_to(ends[1])).sum();
        let gap = points.first().zip(points.last()).map(|(a, b)| a.distance_to(*b));
        let closed = points.len() > 3
            && gap.is_some_and(|gap| gap <= CLOSED_WITHIN.min(OPEN_SHARE * length));
        if closed && gap.is_some_and(|gap| gap < 1e-6) {
            points.pop();
        }
        Self::through(name, &points, closed)
    }

    /// Returns the path with its origin at `origin`, turned to the left by the heading of `origin`.
    #[must_use]
    pub fn placed(mut self, origin: PlanarPose) -> Self {
        for point in &mut self.points {
            let heading = point.heading + origin.heading;
            *point = PlanarPose::new(origin.place(point.position()), heading);
        }
        self
    }

    /// Returns the name of the path.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns the length of one lap, m.
    #[must_use]
    pub fn length(&self) -> f64 {
        let steps = if self.closed { self.points.len() } else { self.points.len() - 1 };
        steps as f64 * self.spacing
    }

    /// Returns whether the path ends where it starts.
    #[must_use]
    pub fn is_closed(&self) -> bool {
        self.closed
    }

    /// Returns the distance between both ends of an open path, m.
    #[must_use]
    pub fn gap(&self) -> Option<f64> {
        let ends = self.points.first().zip(self.points.last()).filter(|_| !self.closed);
        ends.map(|(first, last)| first.distance_to(last.position()))
    }

    /// Returns its points in order, each facing along the path.
    #[must_use]
    pub fn points(&self) -> &[PlanarPose] {
        &self.points
    }

    /// Returns the pose at the start.
    #[must_use]
    pub fn start(&self) -> PlanarPose {
        self.at(0.0)
    }

    /// Returns the smallest area that contains the path.
    #[must_use]
    pub fn bounds(&self) -> Area {
        Area::around(self.points.iter().map(PlanarPose::position))
    }

    /// Returns the pose at an arc length; beyond its ends an open path returns its ends.
    #[must_use]
    pub fn at(&self, arc_length: f64) -> PlanarPose {
        self.points[self.index((arc_length / self.spacing).round() as i64)]
    }

    /// Returns the place on the whole path, in its first lap, at which a robot should join it: near,
    /// and facing along it. Where branches cross, this is the branch that the robot faces.
    #[must_use]
    pub fn join(&self, pose: &PlanarPose) -> Projection {
        /// Distance that corresponds to facing the wrong way, m.
        const TURN: f64 = 0.1;
        let price = |p: &PlanarPose| {
            let squared = p.position().squared_distance_to(pose.position());
            squared + TURN * TURN * (1.0 - (p.heading - pose.heading).cos())
        };
        let best = (0..self.points.len())
            .min_by(|a, b| price(&self.points[*a]).total_cmp(&price(&self.points[*b])))
            .unwrap_or(0);
        self.beside(pose.position(), best as i64)
    }

    /// Returns the nearest place that is reached from the arc length `near` along the path: the
    /// place of a robot that was at `near` a moment ago. Other branches of the path, as in the
    /// middle of a figure eight, are not considered. Where the path turns back on itself, two places are equally near, and
    /// the one ahead counts: a robot that comes within 20 mm of a tip is on its way back. So is one beyond a corner: it is
    /// beside the way that begins there.
    #[must_use]
    pub fn follow(&self, position: Position, near: f64) -> Projection {
        /// Points that the search looks beyond a rise of the distance, to pass corners.
        const PATIENCE: i64 = 4;
        let squared =
            |index: i64| self.points[self.index(index)].position().squared_distance_to(position);
        let start = (near / self.spacing).round() as i64;
        let (mut best, mut least) = (start, squared(start));
        for direction in [1, -1] {
            let mut candidate = start + direction;
            while (candidate - best).abs() <= PATIENCE && (candidate - start).abs() < self.reach() {
                let here = squared(candidate);
                if here < least {
                    (best, least) = (candidate, here);
                }
                candidate += direction;
            }
        }
        let best = if self.is_past_corner(position, best) { best + 1 } else { best };
        self.beside(position, self.past_tip(position, best).unwrap_or(best))
    }

    /// Returns whether a position lies beyond a corner that follows the point of this index.
    fn is_past_corner(&self, position: Position, index: i64) -> bool {
        let point = self.points[self.index(index)];
        let (sin, cos) = point.heading.sin_cos();
        let along = cos * (position.x - point.x) + sin * (position.y - point.y);
        along > self.spacing / 2.0 && self.bend(index) > CORNER
    }

    /// Returns the place on the branch that leads back, if a tip of the path is ahead of this place and that is as near.
    fn past_tip(&self, position: Position, index: i64) -> Option<i64> {
        let most = (TIP / self.spacing) as i64;
        let tip = index + 1 + (0..most / 2).find(|ahead| self.is_tip(index + ahead))?;
        let nearest = |from: i64, to: i64| {
            let points = (from..=to).map(|it| (self.beside(position, it).error.abs(), it));
            points.min_by(|a, b| a.0.total_cmp(&b.0))
        };
        let (here, back) = (self.beside(position, index).error.abs(), nearest(tip, index + most)?);
        (back.0 <= here + ALIKE).then_some(back.1)
    }

    /// Returns whether the path turns back between the point of this index and the next one.
    fn is_tip(&self, index: i64) -> bool {
        self.bend(index) > TURNS_BACK
    }

    /// Returns the change of the course between the point of this index and the next one, rad.
    fn bend(&self, index: i64) -> f64 {
        self.bends[self.index(index)]
    }

    /// Returns the course on which a robot returns to the path within a length: that of the path, and towards it. Where a
    /// corner is nearer than that length, towards the place behind the corner, or else the robot would wait before it.
    #[must_use]
    pub(crate) fn course(&self, position: Position, place: &Projection, length: f64) -> f64 {
        let start = (place.arc_length / self.spacing).round() as i64;
        let most = (length / self.spacing).round() as i64;
        if (0..most).any(|ahead| self.bend(start + ahead) > CORNER) {
            return position.bearing_to(self.ahead(place.arc_length, length).position());
        }
        place.tangent - (place.error / length).atan()
    }

    /// Returns the pose so far ahead of an arc length, or at the tip before it that is more than 20 mm ahead.
    #[must_use]
    pub(crate) fn ahead(&self, arc_length: f64, distance: f64) -> PlanarPose {
        let start = (arc_length / self.spacing).round() as i64;
        let most = (distance / self.spacing).round() as i64;
        let near = (0.5 * TIP / self.spacing) as i64;
        let tip = (near..most).find(|ahead| self.is_tip(start + ahead));
        self.points[self.index(start + tip.unwrap_or(most))]
    }

    /// Returns the projection of a position onto the start of the path.
    #[must_use]
    pub(crate) fn beside_start(&self, position: Position) -> Projection {
        self.beside(position, 0)
    }

    /// Returns how many points a search may pass: at most half a lap.
    fn reach(&self) -> i64 {
        (self.points.len() / 2).max(2) as i64
    }

    /// Projects a position onto the path at the point of this index.
    fn beside(&self, position: Position, index: i64) -> Projection {
        let index = if self.closed { index } else { index.clamp(0, self.points.len() as i64 - 1) };
        let point = self.points[self.index(index)];
        let (sin, cos) = point.heading.sin_cos();
        let (dx, dy) = (position.x - point.x, position.y - point.y);
        let along = cos * dx + sin * dy;
        let across = cos * dy - sin * dx;
        let shift = along.clamp(-self.spacing / 2.0, self.spacing / 2.0);
        Projection {
            arc_length: index as f64 * self.spacing + shift,
            error: across.hypot(along - shift).copysign(across),
            tangent: point.heading,
        }
    }

    fn index(&self, index: i64) -> usize {
        let count = self.points.len() as i64;
        let index = match self.closed {
            // Within the first lap without a division.
            true if (0..count).contains(&index) => index,
            true => index.rem_euclid(count),
            false => index.clamp(0, count - 1),
        };
        index as usize
    }

    fn sampled(name: &str, curve: impl Fn(f64) -> Position) -> Result<Self, PathError> {
        const SAMPLES: u32 = 20_000;
        let chain: Vec<_> = (0..=SAMPLES)
            .map(|i| curve(f64::from(i) / f64::from(SAMPLES) * std::f64::consts::TAU))
            .collect();
        Self::resampled(name, &chain, true)
    }

    /// Makes a path of equally spaced points along a chain of at least two positions.
    fn resampled(name: &str, chain: &[Position], closed: bool) -> Result<Self, PathError> {
        let length: f64 = chain.windows(2).map(|p| p[0].distance_to(p[1])).sum();
        if length >= LONGEST {
            return Err(PathError::TooLong(length));
        }
        let steps = (length / SPACING).ceil().max(2.0) as usize;
        let spacing = length / steps as f64;
        let count = if closed { steps } else { steps + 1 };
        let mut points = Vec::with_capacity(count);
        let (mut segment, mut behind) = (0, 0.0);
        for index in 0..count {
            let wanted = index as f64 * spacing;
            while segment + 2 < chain.len()
                && behind + chain[segment].distance_to(chain[segment + 1]) < wanted - 1e-12
            {
                behind += chain[segment].distance_to(chain[segment + 1]);
                segment += 1;
            }
            let (a, b) = (chain[segment], chain[segment + 1]);
            let share = ((wanted - behind) / a.distance_to(b)).clamp(0.0, 1.0);
            points.push(PlanarPose::new(a.towards(b, share), a.bearing_to(b)));
        }
        let bend = |index: usize| {
            let next = if closed { (index + 1) % count } else { (index + 1).min(count - 1) };
            wrap(points[next].heading - points[index].heading).abs()
        };
        let bends = (0..count).map(bend).collect();
        Ok(Self { name: name.to_owned(), points, bends, spacing, closed })
    }
}

fn size(what: &'static str, value: f64) -> Result<f64, PathError> {
    if (0.01..=100.0).contains(&value) { Ok(value) } else { Err(PathError::Size { what, value }) }
}

fn point(line: &str) -> Option<Position> {
    let mut numbers = line
        .split(|c: char| c == ',' || c == ';' || c.is_whitespace())
        .filter(|part| !part.is_empty())
        .map(|part| part.parse::<f64>().ok().filter(|n| n.is_finite()));
    let (x, y) = (numbers.next()??, numbers.next()??);
    numbers.next().is_none().then_some(Position::new(x, y))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_figure_eight_has_the_asked_width_and_height() {
        let Area { low, high } = Path::figure_eight(1.6, 0.8).unwrap().bounds();
        assert!((high.x - low.x - 1.6).abs() < 1e-4 && (high.y - low.y - 0.8).abs() < 1e-4);
    }

    #[test]
    fn a_circle_is_as_long_as_geometry_says() {
        let length = Path::circle(0.5).unwrap().length();
        assert!((length - std::f64::consts::PI).abs() < 1e-6, "{length}");
    }

    #[test]
    fn following_keeps_to_its_branch_at_the_crossing_of_the_eight() {
        let path = Path::figure_eight(1.6, 0.8).unwrap();
        let half = path.length() / 2.0;
        // In the middle the second branch passes through the same point half a lap later.
        let first = path.follow(Position::new(0.001, 0.0), 0.02).arc_length;
        let second = path.follow(Position::new(0.001, 0.0), half - 0.02).arc_length;
        assert!(first.abs() < 0.01 && (second - half).abs() < 0.01, "{first} {second}");
    }

    #[test]
    fn at_the_crossing_a_robot_joins_the_branch_that_it_faces() {
        let path = Path::figure_eight(1.6, 0.8).unwrap();
        let half = path.length() / 2.0;
        let joined = |heading| path.join(&PlanarPose { x: 0.001, y: 0.0, heading }).arc_length;
        let first = joined(0.8).min(path.length() - joined(0.8));
        assert!(first < 0.05 && (joined(2.4) - half).abs() < 0.05, "{first} {}", joined(2.4));
    }

    #[test]
    fn arc_length_grows_lap_after_lap() {
        let path = Path::circle(0.3).unwrap();
        let mut s = 0.0;
        for step in 0..1000 {
            let angle = f64::from(step) * 0.02;
            s = path.follow(Position::new(0.3 * angle.cos(), 0.3 * angle.sin()), s).arc_length;
        }
        assert!((s - 0.3 * 0.02 * 999.0).abs() < 0.01, "{s}");
    }

    #[test]
    fn the_error_is_positive_on_the_left_and_measures_the_distance() {
        let ends = [Position::ORIGIN, Position::new(1.0, 0.0)];
        let path = Path::through("line", &ends, false).unwrap();
        let left = path.follow(Position::new(0.5012, 0.04), 0.5);
        let beyond = path.follow(Position::new(1.03, -0.04), 1.0);
        assert!((left.error - 0.04).abs() < 1e-9 && (left.arc_length - 0.5012).abs() < 1e-9);
        assert!((beyond.error + 0.05).abs() < 2e-3, "{beyond:?}");
    }

    #[test]
    fn corners_are_passed() {
        let path = Path::square(1.0).unwrap();
        let around = path.follow(Position::new(0.46, 0.52), 0.45);
        assert!((around.arc_length - 0.54).abs() < 0.01, "{around:?}");
    }

    #[test]
    fn waypoints_are_read_with_heading_comments_and_closing_point() {
        let text = "x,y\n0,0 # start\n\n1;0\n1 1\n0,1\n0,0\n";
        let path = Path::from_text("room", text).unwrap();
        let marked = Path::from_text("room", &format!("\u{feff}{text}")).unwrap();
        assert_eq!(marked, path, "a byte-order mark is not part of the first point");
        assert!(path.is_closed() && (path.length() - 4.0).abs() < 1e-9);
    }

    #[test]
    fn a_bad_line_is_named() {
        let error = Path::from_text("room", "0,0\n1,oops\n").unwrap_err();
        assert_eq!(error, PathError::NotAPoint { line: 2, text: "1,oops".into() });
    }

    #[test]
    fn sizes_that_are_no_sizes_are_refused() {
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e6] {
            assert!(Path::circle(bad).is_err() && Path::figure_eight(1.0, bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn a_placed_path_is_the_same_path_elsewhere() {
        let path = Path::circle(0.5).unwrap();
        let length = path.length();
        let placed = path.placed(PlanarPose { x: 3.0, y: 4.0, heading: 1.0 });
        let start = placed.start();
        assert!((start.x - 3.0 - 0.5 * 1f64.cos()).abs() < 1e-9);
        assert!((placed.length() - length).abs() < 1e-12);
    }

    #[test]
    fn a_robot_that_turns_back_at_a_tip_is_on_the_branch_that_leads_back() {
        for (text, tip) in [("0,0\n0.6,0\n0.6,0.3\n0.6,0\n0,0", 0.9), ("0,0\n0.9,0\n0,0", 0.9)] {
            let path = Path::from_text("spur", text).unwrap();
            let place = |s: f64| path.at(s).position();
            let mut reached = tip - 0.1;
            // Up to 10 mm before the tip, and back, beside the path by 3 mm.
            for step in 0..=40 {
                let s = tip - 0.01 - 0.0045 * f64::from((step - 20i32).abs());
                let Position { x, y } = place(s);
                reached = path.follow(Position::new(x + 0.003, y + 0.003), reached).arc_length;
            }
            assert!((reached - tip - 0.1).abs() < 0.01, "{text}: {reached}");
        }
    }

    #[test]
    fn a_robot_that_walked_past_a_corner_is_beside_the_way_behind_it() {
        // Corners on a point of the path, and between two.
        for corner in [0.6, 0.6012, 0.5979] {
            let text = format!("0,0\n{corner},0\n{corner},-0.5\n0,-0.5\n0,0");
            let path = Path::from_text("corner", &text).unwrap();
            for beside in [-0.002, 0.0, 0.002] {
                let place = path.follow(Position::new(corner + 0.02, beside), corner - 0.01);
                assert!((place.tangent + std::f64::consts::FRAC_PI_2).abs() < 1e-9, "{place:?}");
                assert!((place.error - 0.02).abs() < 0.001, "{place:?}");
                assert!((place.arc_length - corner).abs() < 0.006, "{place:?}");
            }
        }
    }

    #[test]
    fn a_loop_whose_ends_nearly_meet_is_closed_and_one_that_is_open_has_a_gap() {
        let circle = |points: u32, last: u32| {
            let point = |i: u32| {
                let angle = std::f64::consts::TAU * f64::from(i) / f64::from(points);
                format!("{},{}\n", 0.4 * angle.cos(), 0.4 * angle.sin())
            };
            Path::from_text("circle", &(0..=last).map(point).collect::<String>()).unwrap()
        };
        for path in [circle(100, 100), circle(100, 99), circle(1000, 999)] {
            assert!(path.is_closed() && path.gap().is_none());
            assert!((path.length() - 0.8 * std::f64::consts::PI).abs() < 0.01, "{}", path.length());
        }
        let slip = Path::from_text("slip", "0,0\n1,0\n1,1\n0,1\n0.0001,0").unwrap();
        assert!(slip.is_closed());
        let arc = circle(100, 75);
        assert!(!arc.is_closed() && arc.gap().is_some_and(|gap| (gap - 0.566).abs() < 0.01));
    }
}
