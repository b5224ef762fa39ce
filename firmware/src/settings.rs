//! What can be tuned: one table, from which storing, listing and checking follow.
//!
//! A setting has a name, a unit, a range, a default and a sentence. **To add one, add its line to
//! the table [`flix_protocol::settings_table`]**: it is then a field of [`Settings`], in
//! `flix parameters list`, checked and stored. Settings of each motor exist twice, `top_...` and `bottom_...`, and are arrays in
//! [`Settings`]. Values are `f32` in the unit named; NaN and infinities are outside every range.
//!
//! Where one value bounds another ([`ORDERED`]), the range that a setting accepts narrows
//! accordingly, and that narrowed range is what lists and refusals show.
//!
//! What a motor is like ([`MOTOR_VALUES`]) is **assumed** until somebody enters it or commissioning measures it, and the
//! robot does not arm until then ([`Settings::assumed`]). A measured value is assumed again when an operator changes what
//! it was measured with ([`DERIVED`]).
//!
//! Stored settings are a list of (hash of name, value, mark) with a format version and a CRC-32. A setting that is new
//! in a firmware therefore starts at its default and keeps the others, and one of another firmware is passed over. A
//! value that is out of range now has its default and is assumed, whatever it is for; bytes that are damaged make all
//! of them so. Either is reported, and nothing of it is written back before an operator says so.
//!
//! Deadlines and what follows from them are constants, not settings: see [`crate::link`].

use flix_protocol::message::{Mark, Parameter, Refusal};
use heapless::{String, Vec};

use crate::alignment::{Alignment, Frame};
use crate::hardware::{Hardware, SettingsStore};
use crate::stored::{self, LoadError, SaveError};
use crate::units::{ElectricalAngle, RotorAngle, TURN_PER_DEGREE};

/// Most bytes that settings take in a [`SettingsStore`].
pub const STORED_LENGTH: usize = 1_000;

/// Version of the stored form.
const FORMAT_VERSION: u16 = 2;
/// Most settings in a stored form: those of another firmware, too.
const MOST_STORED: usize = 96;

/// Everything about a setting but its value.
#[derive(Debug)]
pub struct Setting {
    /// For example `current_limit`; at most 32 bytes.
    pub name: &'static str,
    /// Symbol of the unit, `1` for plain numbers and switches.
    pub unit: &'static str,
    /// Smallest accepted value.
    pub minimum: f32,
    /// Largest accepted value.
    pub maximum: f32,
    /// Value of a new robot.
    pub default: f32,
    /// Whether only whole numbers make sense.
    pub whole: bool,
    /// What it does and where its default comes from.
    pub description: &'static str,
    read: fn(&Settings) -> f32,
    write: fn(&mut Settings, f32),
}

/// Makes the struct and the table from lines of
/// `name: unit, kind, minimum..=maximum, default, description;` where kind is `real` or `whole`.
macro_rules! settings {
    (
        each motor { $($each:ident: $each_unit:literal, $each_kind:ident, $each_minimum:literal ..= $each_maximum:literal, $each_default:expr, $each_description:literal;)* }
        robot { $($name:ident: $unit:literal, $kind:ident, $minimum:literal ..= $maximum:literal, $default:expr, $description:literal;)* }
    ) => {
        /// How many settings there are.
        pub const COUNT: usize = 2 * [$(stringify!($each)),*].len() + [$(stringify!($name)),*].len();

        /// The value of every setting, in the unit that the table names. Motors: top, bottom.
        #[derive(Debug, Clone, Copy, PartialEq)]
        pub struct Settings {
            $(#[doc = concat!($each_description, " In ", $each_unit, ".")] pub $each: [f32; 2],)*
            $(#[doc = concat!($description, " In ", $unit, ".")] pub $name: f32,)*
            /// How each setting is known, in the order of [`TABLE`]; `None` for what is neither a motor's nor assumed.
            pub marks: Marks,
        }

        impl Settings {
            /// A new robot's.
            pub const DEFAULT: Self = Self {
                $($each: [$each_default; 2],)*
                $($name: $default,)*
                marks: Self::ASSUMED,
            };
        }

        /// All settings, in the order in which they are listed: those of each motor first.
        pub static TABLE: [Setting; COUNT] = [
            $(
                settings!(@entry concat!("top_", stringify!($each)), $each_unit, $each_kind, $each_minimum, $each_maximum, $each_default, concat!("Top motor: ", $each_description), $each[0]),
                settings!(@entry concat!("bottom_", stringify!($each)), $each_unit, $each_kind, $each_minimum, $each_maximum, $each_default, concat!("Bottom motor: ", $each_description), $each[1]),
            )*
            $(settings!(@entry stringify!($name), $unit, $kind, $minimum, $maximum, $default, $description, $name),)*
        ];
    };
    (@entry $name:expr, $unit:literal, $kind:ident, $minimum:literal, $maximum:literal, $default:expr, $description:expr, $field:ident $([$motor:literal])?) => {
        Setting {
            name: $name,
            unit: $unit,
            minimum: $minimum,
            maximum: $maximum,
            default: $default,
            whole: settings!(@whole $kind),
            description: $description,
            read: |settings| settings.$field$([$motor])?,
            write: |settings, value| settings.$field$([$motor])? = value,
        }
    };
    (@whole real) => { false };
    (@whole whole) => { true };
}

flix_protocol::settings_table!(settings);

/// How each setting is known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Marks([Option<Mark>; COUNT]);

/// What a motor is like: settings that always have a [`Mark`].
pub const MOTOR_VALUES: [&str; 8] = [
    "top_phase_resistance",
    "bottom_phase_resistance",
    "top_phase_inductance",
    "bottom_phase_inductance",
    "top_flux_linkage",
    "bottom_flux_linkage",
    "pole_pairs",
    "encoder_latency",
];

/// Motor values on which the current depends where it is not measured. The others show by themselves there: a rotor
/// does not follow its alignment with other pole pairs.
const VOLTAGE_MODE_VALUES: [&str; 4] =
    ["top_phase_resistance", "bottom_phase_resistance", "top_flux_linkage", "bottom_flux_linkage"];

/// What alignment finds, and what it is found with; of each motor, or of both.
const ALIGNMENT_VALUES: [&str; 10] = [
    "encoder_zero",
    "encoder_clockwise",
    "pole_pairs",
    "electrical_offset",
    "phases_reversed",
    "current_inverted",
    "encoder_cosine_1",
    "encoder_sine_1",
    "encoder_cosine_2",
    "encoder_sine_2",
];

/// Settings, and the motor values that are measured with them: a back-EMF a turn is a flux linkage by the pole pairs,
/// and currents and voltages are as right as the scales that they are read with.
pub const DERIVED: &[(&str, &[&str])] = &[
    ("pole_pairs", &["top_flux_linkage", "bottom_flux_linkage", "encoder_latency"]),
    ("top_current_gain_a", &["top_phase_resistance", "top_phase_inductance"]),
    ("top_current_gain_b", &["top_phase_resistance", "top_phase_inductance"]),
    ("bottom_current_gain_a", &["bottom_phase_resistance", "bottom_phase_inductance"]),
    ("bottom_current_gain_b", &["bottom_phase_resistance", "bottom_phase_inductance"]),
    (
        "current_scale",
        &[
            "top_phase_resistance",
            "bottom_phase_resistance",
            "top_phase_inductance",
            "bottom_phase_inductance",
        ],
    ),
    (
        "battery_scale",
        &[
            "top_phase_resistance",
            "bottom_phase_resistance",
            "top_phase_inductance",
            "bottom_phase_inductance",
            "top_flux_linkage",
            "bottom_flux_linkage",
        ],
    ),
];

/// Pairs of settings of which the first must not exceed the second.
pub const ORDERED: &[(&str, &str)] = &[
    ("alignment_current", "current_limit"),
    ("current_limit", "over_current"),
    ("under_voltage", "battery_low"),
    ("battery_low", "over_voltage"),
];

/// Why a setting was not changed. Nothing changed.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum SetError {
    /// No setting has this name.
    #[error("no setting has this name")]
    Unknown,
    /// NaN, infinite or outside what is accepted now.
    #[error("{name} must be from {minimum} to {maximum}")]
    OutOfRange {
        /// The setting.
        name: &'static str,
        /// Smallest value accepted now.
        minimum: f32,
        /// Largest value accepted now.
        maximum: f32,
    },
    /// Between two whole numbers.
    #[error("{name} must be a whole number")]
    NotWhole {
        /// The setting.
        name: &'static str,
    },
}

impl From<SetError> for Refusal {
    fn from(error: SetError) -> Self {
        match error {
            SetError::Unknown => Self::UnknownParameter,
            SetError::OutOfRange { name, minimum, maximum } => {
                Self::OutOfRange { name: text(name), minimum, maximum }
            }
            SetError::NotWhole { name } => Self::NotWhole { name: text(name) },
        }
    }
}

impl Settings {
    /// Returns the value of a setting by name.
    #[must_use]
    pub fn get(&self, name: &str) -> Option<f32> {
        TABLE.iter().find(|setting| setting.name == name).map(|setting| (setting.read)(self))
    }

    /// Changes one setting to a value that somebody entered.
    ///
    /// # Errors
    /// When there is none of this name, or the value is not acceptable beside the other values.
    pub fn set(&mut self, name: &str, value: f32) -> Result<(), SetError> {
        self.put(name, value, Mark::Entered)
    }

    /// Changes one setting to a value that is known in this way.
    ///
    /// # Errors
    /// As for [`Settings::set`].
    pub fn put(&mut self, name: &str, value: f32, mark: Mark) -> Result<(), SetError> {
        let setting = TABLE.iter().find(|setting| setting.name == name).ok_or(SetError::Unknown)?;
        let (minimum, maximum) = self.range(setting);
        if !(value >= minimum && value <= maximum) {
            return Err(SetError::OutOfRange { name: setting.name, minimum, maximum });
        }
        if setting.whole && value as i32 as f32 != value {
            return Err(SetError::NotWhole { name: setting.name });
        }
        let is_changed = (setting.read)(self) != value;
        let frames = [0, 1].map(|motor| self.frame(motor));
        (setting.write)(self, value);
        self.count_from(frames);
        self.mark(name, mark);
        // Who measures, measures all of it.
        if is_changed && mark != Mark::Measured {
            self.doubt(name);
        }
        Ok(())
    }

    /// Returns how the angle of a rotor (0: top, 1: bottom) is counted.
    #[must_use]
    pub fn frame(&self, motor: usize) -> Frame {
        Frame {
            zero: RotorAngle::from_degrees(self.encoder_zero[motor % 2]),
            clockwise: self.encoder_clockwise[motor % 2] != 0.0,
            pole_pairs: self.pole_pairs as u32,
        }
    }

    /// Has alignment mean what it meant while angles were counted so: it belongs to the readings of the encoders. With other
    /// pole pairs it means nothing, and is done again.
    fn count_from(&mut self, frames: [Frame; 2]) {
        for (motor, from) in frames.into_iter().enumerate() {
            let to = self.frame(motor);
            if from == to || self.aligned[motor % 2] == switch(false) {
                continue;
            }
            match self.alignment(motor).counted(from, to) {
                Some(alignment) => self.keep(motor, alignment),
                None => self.aligned[motor % 2] = switch(false),
            }
        }
    }

    /// The marks of a new robot.
    const ASSUMED: Marks = {
        let mut marks = [None; COUNT];
        let mut index = 0;
        while index < COUNT {
            if is_motor_value(TABLE[index].name) {
                marks[index] = Some(Mark::Assumed);
            }
            index += 1;
        }
        Marks(marks)
    };

    /// Notes how a value is known. What is no motor's is either assumed or not worth a word.
    fn mark(&mut self, name: &str, mark: Mark) {
        if let Some(slot) = Self::position(name).and_then(|index| self.marks.0.get_mut(index)) {
            let has_mark = mark == Mark::Assumed || is_motor_value(name);
            *slot = has_mark.then_some(mark);
        }
    }

    /// Makes what was measured with a setting assumed again.
    fn doubt(&mut self, name: &str) {
        for (_, derived) in DERIVED.iter().filter(|(from, _)| *from == name) {
            for value in *derived {
                if self.marked(value) == Some(Mark::Measured) {
                    self.mark(value, Mark::Assumed);
                }
            }
        }
    }

    /// Returns how a value is known; `None` for what is neither a motor's nor assumed.
    #[must_use]
    pub fn marked(&self, name: &str) -> Option<Mark> {
        Self::position(name).and_then(|index| self.marks.0.get(index).copied().flatten())
    }

    /// Returns the first assumed value that keeps a robot from arming whose board measures phase currents, or does not.
    #[must_use]
    pub fn assumed(&self, measures_current: bool) -> Option<&'static str> {
        let matters = |name: &str| {
            measures_current || !is_motor_value(name) || VOLTAGE_MODE_VALUES.contains(&name)
        };
        let mut marked = TABLE.iter().zip(self.marks.0);
        marked
            .find(|(setting, mark)| *mark == Some(Mark::Assumed) && matters(setting.name))
            .map(|(setting, _)| setting.name)
    }

    /// Takes what is assumed as if it had been entered.
    ///
    /// # Errors
    /// When the board measures no phase currents and what they depend on is assumed: the name of the value. Nothing is
    /// changed then.
    pub fn accept(&mut self, measures_current: bool) -> Result<(), &'static str> {
        let is_assumed = |name: &&&str| self.marked(name) == Some(Mark::Assumed);
        if let Some(name) =
            VOLTAGE_MODE_VALUES.iter().find(is_assumed).filter(|_| !measures_current)
        {
            return Err(*name);
        }
        for (setting, mark) in TABLE.iter().zip(&mut self.marks.0) {
            if *mark == Some(Mark::Assumed) {
                *mark = is_motor_value(setting.name).then_some(Mark::Entered);
            }
        }
        Ok(())
    }

    /// Returns the same with the board's own figures where these leave it to the board: an `actuation_delay` of zero.
    #[must_use]
    pub fn on(mut self, hardware: &Hardware) -> Self {
        if self.actuation_delay <= 0.0 {
            self.actuation_delay = hardware.actuation_delay_us.into();
        }
        self
    }

    /// Returns these settings, the values of the motors entered as they are.
    #[must_use]
    pub fn entered(mut self) -> Self {
        for name in MOTOR_VALUES {
            self.mark(name, Mark::Entered);
        }
        self
    }

    /// Returns the setting at a position of the list, as operators see it.
    #[must_use]
    pub fn parameter(&self, index: usize) -> Option<Parameter> {
        let setting = TABLE.get(index)?;
        let (minimum, maximum) = self.range(setting);
        Some(Parameter {
            index: u16::try_from(index).ok()?,
            name: text(setting.name),
            unit: text(setting.unit),
            value: (setting.read)(self),
            default: setting.default,
            minimum,
            maximum,
            mark: self.marked(setting.name),
        })
    }

    /// Returns the position of a setting in the list.
    #[must_use]
    pub fn position(name: &str) -> Option<usize> {
        TABLE.iter().position(|setting| setting.name == name)
    }

    /// Returns what a setting accepts now: its own range, narrowed by [`ORDERED`].
    fn range(&self, setting: &Setting) -> (f32, f32) {
        let value = |name| self.get(name);
        let minimum = ORDERED
            .iter()
            .filter(|(_, upper)| *upper == setting.name)
            .filter_map(|(lower, _)| value(lower))
            .fold(setting.minimum, f32::max);
        let maximum = ORDERED
            .iter()
            .filter(|(lower, _)| *lower == setting.name)
            .filter_map(|(_, upper)| value(upper))
            .fold(setting.maximum, f32::min);
        (minimum, maximum)
    }

    /// Gives every value that [`Settings::set`] would not accept its default, and marks it as assumed; returns whether
    /// there was any.
    fn mend(&mut self) -> bool {
        let mut mended = false;
        // Each round takes one value back to its default. Of two that bound each other wrongly one is no default, as the
        // defaults are all accepted.
        while let Some(setting) = TABLE.iter().find(|setting| {
            let value = (setting.read)(self);
            value != setting.default && { *self }.set(setting.name, value).is_err()
        }) {
            (setting.write)(self, setting.default);
            self.mark(setting.name, Mark::Assumed);
            // An alignment of which a part is lost is done again.
            let (top, bottom) = ("top_", "bottom_");
            for (motor, of_motor) in [top, bottom].into_iter().enumerate() {
                let name = setting.name.strip_prefix(of_motor).unwrap_or(setting.name);
                let is_of_other = setting.name.starts_with(if motor == 0 { bottom } else { top });
                if !is_of_other && ALIGNMENT_VALUES.contains(&name) {
                    self.aligned[motor] = switch(false);
                }
            }
            mended = true;
        }
        mended
    }

    /// Reads what was saved, by this firmware or another one: what cannot be trusted has its default. Says whether there
    /// was such, and why: the store failed, or what it holds is damaged or out of range.
    pub fn load<S: SettingsStore>(store: &mut S) -> (Self, Result<(), LoadError>) {
        let mut settings = Self::DEFAULT;
        let stored: Stored = match stored::load(store, FORMAT_VERSION, &mut [0; STORED_LENGTH]) {
            Ok(stored) => stored.unwrap_or_default(),
            Err(error) => return (settings, Err(error)),
        };
        for (hash, value, mark) in stored {
            if let Some(setting) = TABLE.iter().find(|setting| name_hash(setting.name) == hash) {
                (setting.write)(&mut settings, value);
                if let Some(mark) = mark {
                    settings.mark(setting.name, mark);
                }
            }
        }
        let loaded = if settings.mend() { Err(LoadError::OutOfRange) } else { Ok(()) };
        (settings, loaded)
    }

    /// Keeps these settings over power-off.
    ///
    /// # Errors
    /// When the store fails.
    pub fn save<S: SettingsStore>(&self, store: &mut S) -> Result<(), SaveError> {
        let entry = |setting: &Setting| {
            (name_hash(setting.name), (setting.read)(self), self.marked(setting.name))
        };
        let mut buffer = [0; STORED_LENGTH];
        let entries: Stored = TABLE.iter().map(entry).collect();
        let bytes = stored::encode(FORMAT_VERSION, &entries, &mut buffer)?;
        store.save(bytes).map_err(|_| SaveError)
    }

    /// Returns what alignment found about a motor (0: top, 1: bottom), if all was kept.
    #[must_use]
    pub fn alignment(&self, motor: usize) -> Alignment {
        let eccentricity_deg = [
            self.encoder_cosine_1[motor],
            self.encoder_sine_1[motor],
            self.encoder_cosine_2[motor],
            self.encoder_sine_2[motor],
        ];
        Alignment {
            electrical_offset: ElectricalAngle::from_degrees(self.electrical_offset[motor]),
            reversed: self.phases_reversed[motor] != 0.0,
            current_inverted: self.current_inverted[motor] != 0.0,
            eccentricity: eccentricity_deg.map(|part| (part * TURN_PER_DEGREE) as i32),
        }
    }

    /// Takes over what alignment found: top, bottom.
    pub fn learn(&mut self, alignment: [Alignment; 2]) {
        for (motor, found) in alignment.into_iter().enumerate() {
            self.aligned[motor] = switch(true);
            self.keep(motor, found);
        }
    }

    /// Notes an alignment of a motor.
    fn keep(&mut self, motor: usize, found: Alignment) {
        let [cosine_1, sine_1, cosine_2, sine_2] = found.eccentricity.map(|part| {
            (part as f32 / TURN_PER_DEGREE)
                .clamp(-LARGEST_ECCENTRICITY_DEG, LARGEST_ECCENTRICITY_DEG)
        });
        let motor = motor % 2;
        self.electrical_offset[motor] = found.electrical_offset.degrees();
        self.phases_reversed[motor] = switch(found.reversed);
        self.current_inverted[motor] = switch(found.current_inverted);
        self.encoder_cosine_1[motor] = cosine_1;
        self.encoder_sine_1[motor] = sine_1;
        self.encoder_cosine_2[motor] = cosine_2;
        self.encoder_sine_2[motor] = sine_2;
    }
}

/// The range of the encoder error's terms in the table.
const LARGEST_ECCENTRICITY_DEG: f32 = 10.0;

const fn switch(on: bool) -> f32 {
    if on { 1.0 } else { 0.0 }
}

/// The stored form: hashes of names, values and their marks.
type Stored = Vec<(u32, f32, Option<Mark>), MOST_STORED>;

/// Returns whether a setting says what a motor is like.
const fn is_motor_value(name: &str) -> bool {
    let mut index = 0;
    while index < MOTOR_VALUES.len() {
        if same(MOTOR_VALUES[index].as_bytes(), name.as_bytes()) {
            return true;
        }
        index += 1;
    }
    false
}

/// Compares at compile time, too.
const fn same(one: &[u8], other: &[u8]) -> bool {
    if one.len() != other.len() {
        return false;
    }
    let mut index = 0;
    while index < one.len() {
        if one[index] != other[index] {
            return false;
        }
        index += 1;
    }
    true
}

/// Returns the FNV-1a hash of a name: names are few and a test shows that none collide.
fn name_hash(name: &str) -> u32 {
    name.bytes().fold(0x811c_9dc5, |hash, byte| (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193))
}

/// Returns as much of a text as fits. The table's texts all fit, which a test shows.
pub(crate) fn text<const N: usize>(text: &str) -> String<N> {
    let mut out = String::new();
    for character in text.chars() {
        if out.push(character).is_err() {
            break;
        }
    }
    out
}

/// The settings in force, what is stored, and the store.
pub struct Tuning<S> {
    store: S,
    present: Settings,
    stored: Settings,
    loaded: Result<(), LoadError>,
    learnt: bool,
    revision: u16,
}

impl<S: SettingsStore> Tuning<S> {
    /// Reads what is stored. What cannot be trusted has its default, and [`Tuning::loaded`] says why.
    pub fn new(mut store: S) -> Self {
        let (settings, loaded) = Settings::load(&mut store);
        Self { store, present: settings, stored: settings, loaded, learnt: false, revision: 0 }
    }

    /// Returns whether what was stored could be read at power-up.
    ///
    /// # Errors
    /// When defaults are in force instead of what was stored.
    pub const fn loaded(&self) -> Result<(), LoadError> {
        self.loaded
    }

    /// Returns the settings in force.
    #[must_use]
    pub const fn settings(&self) -> &Settings {
        &self.present
    }

    /// Changes one setting until power-off, to a value that is known in this way.
    ///
    /// # Errors
    /// As for [`Settings::set`].
    pub fn put(&mut self, name: &str, value: f32, mark: Mark) -> Result<(), SetError> {
        self.present.put(name, value, mark)?;
        self.revision = self.revision.wrapping_add(1);
        Ok(())
    }

    /// Takes what is assumed as if it had been entered, until power-off.
    ///
    /// # Errors
    /// As for [`Settings::accept`].
    pub fn accept(&mut self, measures_current: bool) -> Result<(), &'static str> {
        self.present.accept(measures_current)
    }

    /// Puts the defaults in force until power-off: what the motors are like is assumed then.
    pub fn reset(&mut self) {
        self.present = Settings::DEFAULT;
        self.revision = self.revision.wrapping_add(1);
    }

    /// Changes whenever an operator changes settings: what the fast half learns it knows already.
    #[must_use]
    pub const fn revision(&self) -> u16 {
        self.revision
    }

    /// Keeps what is in force over power-off.
    ///
    /// # Errors
    /// When the store fails.
    pub fn save(&mut self) -> Result<(), SaveError> {
        self.present.save(&mut self.store)?;
        self.stored = self.present;
        self.learnt = false;
        Ok(())
    }

    /// Takes over what alignment found: top, bottom.
    pub fn learn(&mut self, alignment: [Alignment; 2]) {
        self.present.learn(alignment);
        let motors = [0, 1].map(|motor| {
            // The zero that is tried is not the stored one.
            alignment[motor].counted(self.present.frame(motor), self.stored.frame(motor))
        });
        if let [Some(top), Some(bottom)] = motors {
            self.stored.learn([top, bottom]);
            self.learnt = true;
        }
    }

    /// Keeps what alignment found over power-off, without the settings that are only being tried.
    /// Returns whether there was anything to write. Writing flash can take milliseconds: call it
    /// while the motors are not driven.
    ///
    /// # Errors
    /// When the store fails; it is not tried again until the next alignment.
    pub fn save_learnt(&mut self) -> Result<bool, SaveError> {
        if !core::mem::take(&mut self.learnt) {
            return Ok(false);
        }
        self.stored.save(&mut self.store).map(|()| true)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::board::DENGFOC_V3_01;
    use crate::fast::configuration::Configuration;
    use crate::hardware::EncoderAngle;

    /// Keeps bytes as a flash partition would.
    #[derive(Default)]
    struct Memory(Option<std::vec::Vec<u8>>);

    impl SettingsStore for Memory {
        type Error = ();

        fn load(&mut self, buffer: &mut [u8]) -> Result<Option<usize>, ()> {
            let Some(bytes) = &self.0 else { return Ok(None) };
            buffer.get_mut(..bytes.len()).ok_or(())?.copy_from_slice(bytes);
            Ok(Some(bytes.len()))
        }

        fn save(&mut self, bytes: &[u8]) -> Result<(), ()> {
            self.0 = Some(bytes.to_vec());
            Ok(())
        }
    }

    fn tuned() -> Settings {
        let mut settings = Settings::DEFAULT;
        settings.set("top_phase_resistance", 1.25).unwrap();
        settings.set("bottom_encoder_zero", -90.0).unwrap();
        settings.set("over_speed", 60.0).unwrap();
        settings
    }

    fn saved(settings: &Settings) -> Memory {
        let mut store = Memory::default();
        settings.save(&mut store).unwrap();
        store
    }

    #[test]
    fn every_default_is_accepted_by_its_own_range() {
        assert!(!{ Settings::DEFAULT }.mend());
    }

    #[test]
    fn every_setting_reaches_an_operator_uncut() {
        for (index, setting) in TABLE.iter().enumerate() {
            let parameter = Settings::DEFAULT.parameter(index).unwrap();
            assert_eq!(
                (parameter.name.as_str(), parameter.unit.as_str()),
                (setting.name, setting.unit)
            );
        }
    }

    #[test]
    fn no_two_names_have_one_hash() {
        let hashes: std::collections::HashSet<u32> =
            TABLE.iter().map(|setting| name_hash(setting.name)).collect();
        assert_eq!(hashes.len(), COUNT);
    }

    #[test]
    fn settings_survive_power_off() {
        assert_eq!(Settings::load(&mut saved(&tuned())), (tuned(), Ok(())));
    }

    #[test]
    fn a_new_robot_has_nothing_stored() {
        assert_eq!(Settings::load(&mut Memory::default()), (Settings::DEFAULT, Ok(())));
    }

    #[test]
    fn any_damaged_bit_is_noticed() {
        let intact = saved(&tuned()).0.unwrap();
        for bit in 0..intact.len() * 8 {
            let mut damaged = intact.clone();
            damaged[bit / 8] ^= 1 << (bit % 8);
            let loaded = Settings::load(&mut Memory(Some(damaged)));
            assert_eq!(loaded, (Settings::DEFAULT, Err(LoadError::Damaged)), "bit {bit}");
        }
    }

    #[test]
    fn settings_cut_short_anywhere_are_noticed() {
        let intact = saved(&tuned()).0.unwrap();
        for length in 0..intact.len() {
            let loaded = Settings::load(&mut Memory(Some(intact[..length].to_vec())));
            assert_eq!(loaded, (Settings::DEFAULT, Err(LoadError::Damaged)), "{length} bytes");
        }
    }

    fn store_of(version: u16, values: &impl serde::Serialize) -> Memory {
        let mut buffer = [0; 2 * STORED_LENGTH];
        Memory(Some(stored::encode(version, values, &mut buffer).unwrap().to_vec()))
    }

    /// As [`Settings::save`] stores, these alone.
    fn store_with(values: &[(&str, f32, Option<Mark>)]) -> Memory {
        let entries: std::vec::Vec<_> =
            values.iter().map(|(name, value, mark)| (name_hash(name), *value, *mark)).collect();
        store_of(FORMAT_VERSION, &entries.as_slice())
    }

    #[test]
    fn another_format_version_is_named() {
        let loaded = Settings::load(&mut store_of(FORMAT_VERSION + 1, &<&[u8]>::default()));
        assert_eq!(loaded, (Settings::DEFAULT, Err(LoadError::Version)));
    }

    #[test]
    fn settings_of_another_firmware_are_passed_over_however_many_and_the_others_kept() {
        let other = (0..30).map(|number| (number, 1.0_f32, None::<Mark>));
        let known = (name_hash("over_speed"), 60.0, None);
        let entries: std::vec::Vec<_> = other.chain([known]).collect();
        let expected = Settings { over_speed: 60.0, ..Settings::DEFAULT };
        let mut store = store_of(FORMAT_VERSION, &entries.as_slice());
        assert_eq!(Settings::load(&mut store), (expected, Ok(())));
    }

    #[test]
    fn a_stored_value_that_is_no_number_or_out_of_range_is_reported_and_the_others_kept() {
        let mut expected = Settings { telemetry_rate: 20.0, ..Settings::DEFAULT };
        expected.mark("over_speed", Mark::Assumed);
        for value in [f32::NAN, f32::INFINITY, -1.0, 1e9] {
            let mut store =
                store_with(&[("telemetry_rate", 20.0, None), ("over_speed", value, None)]);
            let loaded = Settings::load(&mut store);
            assert_eq!(loaded, (expected, Err(LoadError::OutOfRange)), "{value}");
        }
    }

    #[test]
    fn stored_values_that_bound_each_other_wrongly_have_their_defaults() {
        let mut store = store_with(&[("over_current", 1.0, None), ("current_limit", 1.5, None)]);
        let (settings, loaded) = Settings::load(&mut store);
        assert_eq!(loaded, Err(LoadError::OutOfRange));
        let values = [settings.over_current, settings.current_limit];
        assert_eq!(values, [Settings::DEFAULT.over_current, Settings::DEFAULT.current_limit]);
    }

    #[test]
    fn no_invalid_value_takes_another_with_it_and_each_keeps_the_robot_from_arming_until_it_is_set()
    {
        let known =
            Settings { over_speed: 60.0, telemetry_rate: 20.0, ..Settings::DEFAULT.entered() };
        for (index, setting) in TABLE.iter().enumerate() {
            let mut damaged = known;
            (setting.write)(&mut damaged, f32::NAN);
            let mut store = saved(&damaged);
            let (mut loaded, outcome) = Settings::load(&mut store);
            assert_eq!(outcome, Err(LoadError::OutOfRange));
            assert_eq!(loaded.assumed(true), Some(setting.name));
            for (_, other) in TABLE.iter().enumerate().filter(|(other, _)| *other != index) {
                assert_eq!((other.read)(&loaded), (other.read)(&known), "{}", setting.name);
            }
            // Stored again, it is assumed still.
            loaded.save(&mut store).unwrap();
            assert_eq!(Settings::load(&mut store), (loaded, Ok(())));
            loaded.set(setting.name, setting.default).unwrap();
            assert_eq!(loaded.assumed(true), None);
        }
    }

    #[test]
    fn a_measured_value_is_assumed_again_when_what_it_was_measured_with_changes() {
        let measured = |settings: &mut Settings| {
            for name in MOTOR_VALUES {
                let value = settings.get(name).unwrap();
                settings.put(name, value, Mark::Measured).unwrap();
            }
        };
        for (from, derived) in DERIVED {
            let mut settings = Settings::DEFAULT;
            measured(&mut settings);
            let value = settings.get(from).unwrap();
            settings.set(from, value).unwrap();
            assert_eq!(settings.assumed(true), None, "{from} is what it was");
            let other = if value == 1.0 { 1.5 } else { 11.0 };
            settings.set(from, other).unwrap();
            for name in MOTOR_VALUES.iter().filter(|name| *name != from) {
                let is_assumed = settings.marked(name) == Some(Mark::Assumed);
                assert_eq!(is_assumed, derived.contains(name), "{name} after {from}");
            }
            // Who enters values knows them, in whatever order.
            let mut settings = Settings::DEFAULT.entered();
            settings.set(from, other).unwrap();
            assert_eq!(settings.assumed(true), None);
            // And who measures, measures all.
            measured(&mut settings);
            settings.put(from, value, Mark::Measured).unwrap();
            assert_eq!(settings.assumed(true), None);
        }
    }

    #[test]
    fn what_is_derived_from_what_are_settings() {
        let names = DERIVED.iter().flat_map(|(from, derived)| derived.iter().chain([from]));
        assert!(names.chain(&VOLTAGE_MODE_VALUES).all(|name| Settings::position(name).is_some()));
    }

    #[test]
    fn what_is_assumed_is_accepted_only_where_currents_show_whether_it_is_right() {
        let mut settings = Settings::DEFAULT;
        assert_eq!(settings.accept(false), Err("top_phase_resistance"));
        assert_eq!(settings, Settings::DEFAULT);
        settings.accept(true).unwrap();
        assert_eq!(settings, Settings::DEFAULT.entered());
        let mut settings = Settings::DEFAULT;
        for name in VOLTAGE_MODE_VALUES {
            assert_eq!(settings.assumed(false), Some(name));
            settings.set(name, 4.0).unwrap();
        }
        assert_eq!(settings.assumed(false), None);
    }

    #[test]
    fn a_motors_value_that_cannot_be_trusted_is_assumed_again() {
        let mut settings = Settings::DEFAULT.entered();
        settings.pole_pairs = 7.5;
        let (loaded, _) = Settings::load(&mut saved(&settings));
        assert_eq!((loaded.assumed(true), loaded.pole_pairs), (Some("pole_pairs"), 7.0));
    }

    #[test]
    fn how_a_value_is_known_survives_power_off() {
        let mut settings = Settings::DEFAULT;
        settings.put("pole_pairs", 11.0, Mark::Measured).unwrap();
        settings.set("encoder_latency", 250.0).unwrap();
        assert_eq!(Settings::load(&mut saved(&settings)), (settings, Ok(())));
    }

    #[test]
    fn motors_are_known_once_each_of_their_values_was_entered_or_measured() {
        let mut settings = Settings::DEFAULT;
        for (index, name) in MOTOR_VALUES.into_iter().enumerate() {
            assert!(
                settings.assumed(true).is_some() && settings.marked(name) == Some(Mark::Assumed)
            );
            let mark = if index % 2 == 0 { Mark::Entered } else { Mark::Measured };
            let value = settings.get(name).unwrap();
            settings.put(name, value, mark).unwrap();
        }
        assert_eq!(settings.assumed(true), None);
    }

    #[test]
    fn numbers_that_make_no_sense_are_refused_with_the_range_and_change_nothing() {
        let refusal = SetError::OutOfRange { name: "over_speed", minimum: 10.0, maximum: 200.0 };
        for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 9.99, 200.01] {
            let mut settings = Settings::DEFAULT;
            let outcome = settings.set("over_speed", value);
            assert_eq!((outcome, settings), (Err(refusal), Settings::DEFAULT), "{value}");
        }
    }

    #[test]
    fn a_value_that_another_bounds_is_refused_beyond_it() {
        let over_current = Settings::DEFAULT.over_current;
        let outcome = { Settings::DEFAULT }.set("current_limit", over_current + 0.1);
        let Err(SetError::OutOfRange { maximum, .. }) = outcome else {
            panic!("accepted: {outcome:?}")
        };
        assert_eq!(maximum, over_current);
    }

    #[test]
    fn half_a_pole_pair_is_refused() {
        let outcome = { Settings::DEFAULT }.set("pole_pairs", 7.5);
        assert_eq!(outcome, Err(SetError::NotWhole { name: "pole_pairs" }));
    }

    #[test]
    fn an_unknown_name_is_refused() {
        assert_eq!({ Settings::DEFAULT }.set("warp_factor", 9.0), Err(SetError::Unknown));
    }

    #[test]
    fn what_alignment_found_reaches_the_fast_half_again() {
        let mut settings = Settings::DEFAULT;
        let found = Alignment {
            electrical_offset: ElectricalAngle::from_raw(0x4000_0000),
            reversed: true,
            current_inverted: true,
            eccentricity: [1 << 24, -(1 << 23), 0, 0],
        };
        settings.learn([found; 2]);
        assert_eq!([0, 1].map(|motor| settings.alignment(motor)), [found; 2]);
    }

    #[test]
    fn what_alignment_found_is_kept_without_settings_that_are_only_being_tried() {
        let mut tuning = Tuning::new(Memory::default());
        tuning.put("over_speed", 60.0, Mark::Entered).unwrap();
        tuning.learn([Alignment { reversed: true, ..Alignment::default() }; 2]);
        assert_eq!(tuning.save_learnt(), Ok(true));
        let stored = Settings::load(&mut tuning.store).0;
        let kept = (stored.aligned, stored.phases_reversed, stored.over_speed);
        assert_eq!(kept, ([1.0; 2], [1.0; 2], Settings::DEFAULT.over_speed));
    }

    /// Returns the electrical angle that a robot of these settings has for a reading of the top encoder, after correction.
    fn electrical_angle(settings: &Settings, reading: u32) -> ElectricalAngle {
        let configuration = Configuration::new(settings, &DENGFOC_V3_01.hardware);
        let encoder = &configuration.encoders[0];
        let uncorrected = encoder.uncorrected(EncoderAngle::from_raw(reading));
        let angle = uncorrected.turned(encoder.correction(uncorrected).wrapping_neg());
        configuration.electrical_angle(0, angle)
    }

    /// Aligned, of one phase order or the other, with a magnet beside the axis.
    fn aligned(reversed: bool) -> Settings {
        let mut settings = Settings { encoder_zero: [40.0; 2], ..Settings::DEFAULT };
        let found = Alignment {
            electrical_offset: ElectricalAngle::from_degrees(65.1),
            reversed,
            current_inverted: false,
            eccentricity: [4.0, -3.0, 1.5, 1.0].map(|it: f32| (it * TURN_PER_DEGREE) as i32),
        };
        settings.learn([found; 2]);
        settings
    }

    #[test]
    fn a_zero_that_is_changed_after_alignment_moves_the_offset_with_it() {
        let mut settings = aligned(true);
        settings.set("top_encoder_zero", 46.0).unwrap();
        assert!((settings.electrical_offset[0] - 107.1).abs() < 1e-3, "{settings:?}");
        assert_eq!(settings.electrical_offset[1], aligned(true).electrical_offset[1]);
        assert_eq!(settings.aligned, [1.0; 2]);
    }

    #[test]
    fn commutation_belongs_to_the_readings_whatever_zero_and_direction_are_entered_afterwards() {
        // 0.2 electrical degrees: the table of eccentricity is interpolated otherwise.
        let tolerance = (0.2 * TURN_PER_DEGREE) as i32;
        for reversed in [false, true] {
            let before = aligned(reversed);
            for (zero, clockwise) in
                [(46.0, 0.0), (-5.0, 0.0), (40.0, 1.0), (200.0, 1.0), (359.0, 0.0), (-180.0, 1.0)]
            {
                for zero_first in [false, true] {
                    let mut after = before;
                    for step in [zero_first, !zero_first] {
                        let (name, value) = match step {
                            true => ("top_encoder_zero", zero),
                            false => ("top_encoder_clockwise", clockwise),
                        };
                        after.set(name, value).unwrap();
                    }
                    for reading in (0..1 << 12).map(|step| step << 20 | 0x7_0000) {
                        let [was, is] = [before, after].map(|it| electrical_angle(&it, reading));
                        let off = is.ahead_of(was).unsigned_abs();
                        assert!(off < tolerance as u32, "{zero} {clockwise} {reading}: {off}");
                    }
                }
            }
        }
    }

    #[test]
    fn other_pole_pairs_align_anew() {
        let mut settings = aligned(false);
        settings.set("pole_pairs", 7.0).unwrap();
        assert_eq!(settings.aligned, [1.0; 2]);
        settings.set("pole_pairs", 11.0).unwrap();
        assert_eq!(settings.aligned, [0.0; 2]);
    }

    #[test]
    fn an_alignment_of_which_a_part_was_lost_is_done_again() {
        for name in ["encoder_zero", "electrical_offset", "encoder_sine_2"] {
            let mut settings = aligned(false);
            let name = std::format!("bottom_{name}");
            let setting = TABLE.iter().find(|setting| setting.name == name).unwrap();
            (setting.write)(&mut settings, f32::NAN);
            let loaded = Settings::load(&mut saved(&settings)).0;
            assert_eq!(loaded.aligned, [1.0, 0.0], "{name}");
        }
    }

    #[test]
    fn what_alignment_found_with_a_zero_that_is_only_tried_is_stored_for_the_stored_zero() {
        let mut tuning = Tuning::new(saved(&Settings::DEFAULT));
        tuning.put("top_encoder_zero", 30.0, Mark::Entered).unwrap();
        tuning.learn([aligned(true).alignment(0); 2]);
        assert_eq!(tuning.save_learnt(), Ok(true));
        let stored = Settings::load(&mut tuning.store).0;
        assert_eq!((stored.encoder_zero, stored.aligned), ([0.0; 2], [1.0; 2]));
        let [tried, kept] = [*tuning.settings(), stored].map(|it| electrical_angle(&it, 1 << 30));
        assert!(kept.ahead_of(tried).unsigned_abs() < (0.2 * TURN_PER_DEGREE) as u32);
        // With pole pairs that are only tried it is not stored at all.
        tuning.put("pole_pairs", 9.0, Mark::Entered).unwrap();
        tuning.learn([Alignment::default(); 2]);
        assert_eq!(tuning.save_learnt(), Ok(false));
    }

    #[test]
    fn whatever_alignment_finds_can_be_stored() {
        let mut settings = Settings::DEFAULT;
        let extreme = Alignment {
            electrical_offset: ElectricalAngle::from_raw(u32::MAX),
            eccentricity: [i32::MAX; 4],
            ..Alignment::default()
        };
        settings.learn([extreme; 2]);
        assert_eq!(Settings::load(&mut saved(&settings)), (settings, Ok(())));
    }
}
