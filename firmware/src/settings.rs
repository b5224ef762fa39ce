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
//! Stored settings are a list of (hash of name, value) with a format version and a CRC-32. A
//! setting that is new in a firmware therefore starts at its default and keeps the others; only
//! bytes that are damaged, or a value that is out of range now, make the whole default.
//!
//! Deadlines and what follows from them are constants, not settings: see [`crate::link`].

use flix_protocol::message::{Parameter, Refusal};
use heapless::{String, Vec};

use crate::fast::alignment::Alignment;
use crate::fast::units::{ElectricalAngle, TURN_PER_DEGREE};
use crate::hardware::SettingsStore;
use crate::stored::{self, LoadError, SaveError};

/// Most bytes that settings take in a [`SettingsStore`].
pub const STORED_LENGTH: usize = 8 + COUNT * 9;

/// Version of the stored form.
const FORMAT_VERSION: u16 = 1;
/// How many settings there are.
pub const COUNT: usize = TABLE.len();

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
        /// The value of every setting, in the unit that the table names. Motors: top, bottom.
        #[derive(Debug, Clone, Copy, PartialEq)]
        pub struct Settings {
            $(#[doc = concat!($each_description, " In ", $each_unit, ".")] pub $each: [f32; 2],)*
            $(#[doc = concat!($description, " In ", $unit, ".")] pub $name: f32,)*
        }

        impl Settings {
            /// A new robot's.
            pub const DEFAULT: Self = Self {
                $($each: [$each_default; 2],)*
                $($name: $default,)*
            };
        }

        /// All settings, in the order in which they are listed: those of each motor first.
        pub static TABLE: &[Setting] = &[
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
        /// Which setting.
        name: &'static str,
        /// Smallest value accepted now.
        minimum: f32,
        /// Largest value accepted now.
        maximum: f32,
    },
    /// Between two whole numbers.
    #[error("{name} must be a whole number")]
    NotWhole {
        /// Which setting.
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

    /// Changes one setting.
    ///
    /// # Errors
    /// When there is none of this name, or the value is not acceptable beside the other values.
    pub fn set(&mut self, name: &str, value: f32) -> Result<(), SetError> {
        let setting = TABLE.iter().find(|setting| setting.name == name).ok_or(SetError::Unknown)?;
        let (minimum, maximum) = self.range(setting);
        if !(value >= minimum && value <= maximum) {
            return Err(SetError::OutOfRange { name: setting.name, minimum, maximum });
        }
        if setting.whole && value as i32 as f32 != value {
            return Err(SetError::NotWhole { name: setting.name });
        }
        (setting.write)(self, value);
        Ok(())
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

    /// Returns whether each value is one that [`Settings::set`] accepts.
    fn is_valid(&self) -> bool {
        let mut copy = *self;
        TABLE.iter().all(|setting| copy.set(setting.name, (setting.read)(self)).is_ok())
    }

    /// Reads what was saved. `Ok(None)` when nothing ever was.
    ///
    /// # Errors
    /// When the store fails or what it holds cannot be trusted.
    pub fn load<S: SettingsStore>(store: &mut S) -> Result<Option<Self>, LoadError> {
        let values: Option<Stored> = stored::load(store, FORMAT_VERSION, &mut [0; STORED_LENGTH])?;
        let Some(values) = values else { return Ok(None) };
        let mut settings = Self::DEFAULT;
        for (hash, value) in values {
            if let Some(setting) = TABLE.iter().find(|setting| name_hash(setting.name) == hash) {
                (setting.write)(&mut settings, value);
            }
        }
        if settings.is_valid() { Ok(Some(settings)) } else { Err(LoadError::Damaged) }
    }

    /// Keeps these settings over power-off.
    ///
    /// # Errors
    /// When the store fails.
    pub fn save<S: SettingsStore>(&self, store: &mut S) -> Result<(), SaveError> {
        let value = |setting: &Setting| (name_hash(setting.name), (setting.read)(self));
        let mut buffer = [0; STORED_LENGTH];
        let bytes = stored::encode(
            FORMAT_VERSION,
            &TABLE.iter().map(value).collect::<Stored>(),
            &mut buffer,
        )?;
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
            let [cosine_1, sine_1, cosine_2, sine_2] = found.eccentricity.map(|part| {
                (part as f32 / TURN_PER_DEGREE)
                    .clamp(-LARGEST_ECCENTRICITY_DEG, LARGEST_ECCENTRICITY_DEG)
            });
            self.aligned[motor] = switch(true);
            self.electrical_offset[motor] = found.electrical_offset.degrees();
            self.phases_reversed[motor] = switch(found.reversed);
            self.current_inverted[motor] = switch(found.current_inverted);
            self.encoder_cosine_1[motor] = cosine_1;
            self.encoder_sine_1[motor] = sine_1;
            self.encoder_cosine_2[motor] = cosine_2;
            self.encoder_sine_2[motor] = sine_2;
        }
    }
}

/// The range of the encoder error's terms in the table.
const LARGEST_ECCENTRICITY_DEG: f32 = 10.0;

const fn switch(on: bool) -> f32 {
    if on { 1.0 } else { 0.0 }
}

/// The stored form: hashes of names, and values.
type Stored = Vec<(u32, f32), COUNT>;

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
    /// Reads what is stored. When that cannot be trusted the defaults are in force, and
    /// [`Tuning::loaded`] says why.
    pub fn new(mut store: S) -> Self {
        let (settings, loaded) = match Settings::load(&mut store) {
            Ok(settings) => (settings.unwrap_or(Settings::DEFAULT), Ok(())),
            Err(error) => (Settings::DEFAULT, Err(error)),
        };
        Self { store, present: settings, stored: settings, loaded, learnt: false, revision: 0 }
    }

    /// Returns whether what was stored could be read at power-up.
    ///
    /// # Errors
    /// When the defaults are in force instead of what was stored.
    pub const fn loaded(&self) -> Result<(), LoadError> {
        self.loaded
    }

    /// Returns the settings in force.
    #[must_use]
    pub const fn settings(&self) -> &Settings {
        &self.present
    }

    /// Changes one setting until power-off.
    ///
    /// # Errors
    /// As for [`Settings::set`].
    pub fn set(&mut self, name: &str, value: f32) -> Result<(), SetError> {
        self.present.set(name, value)?;
        self.revision = self.revision.wrapping_add(1);
        Ok(())
    }

    /// Puts the defaults in force until power-off.
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
        self.stored.learn(alignment);
        self.learnt = true;
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
    use crate::stored::CRC;

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
        assert!(Settings::DEFAULT.is_valid());
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
        assert_eq!(Settings::load(&mut saved(&tuned())), Ok(Some(tuned())));
    }

    #[test]
    fn a_new_robot_has_nothing_stored() {
        assert_eq!(Settings::load(&mut Memory::default()), Ok(None));
    }

    #[test]
    fn any_damaged_bit_is_noticed() {
        let intact = saved(&tuned()).0.unwrap();
        for bit in 0..intact.len() * 8 {
            let mut damaged = intact.clone();
            damaged[bit / 8] ^= 1 << (bit % 8);
            let loaded = Settings::load(&mut Memory(Some(damaged)));
            assert_eq!(loaded, Err(LoadError::Damaged), "bit {bit}");
        }
    }

    #[test]
    fn settings_cut_short_anywhere_are_noticed() {
        let intact = saved(&tuned()).0.unwrap();
        for length in 0..intact.len() {
            let loaded = Settings::load(&mut Memory(Some(intact[..length].to_vec())));
            assert_eq!(loaded, Err(LoadError::Damaged), "{length} bytes");
        }
    }

    fn store_of(version: u16, values: &[(u32, f32)]) -> Memory {
        let values: Stored = values.iter().copied().collect();
        let mut buffer = [0; STORED_LENGTH];
        let bytes =
            postcard::to_slice_crc32(&(version, values), &mut buffer, CRC.digest()).unwrap();
        Memory(Some(bytes.to_vec()))
    }

    #[test]
    fn another_format_version_is_named() {
        let loaded = Settings::load(&mut store_of(FORMAT_VERSION + 1, &[]));
        assert_eq!(loaded, Err(LoadError::Version));
    }

    #[test]
    fn a_setting_that_is_new_in_this_firmware_starts_at_its_default() {
        let older = store_of(
            FORMAT_VERSION,
            &[(name_hash("over_speed"), 60.0), (name_hash("a_setting_of_old"), 1.0)],
        )
        .0;
        let expected = Settings { over_speed: 60.0, ..Settings::DEFAULT };
        assert_eq!(Settings::load(&mut Memory(older)), Ok(Some(expected)));
    }

    #[test]
    fn a_stored_value_that_is_no_number_or_out_of_range_is_damage() {
        for value in [f32::NAN, f32::INFINITY, -1.0, 1e9] {
            let mut store = store_of(FORMAT_VERSION, &[(name_hash("over_speed"), value)]);
            assert_eq!(Settings::load(&mut store), Err(LoadError::Damaged), "{value}");
        }
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
        tuning.set("over_speed", 60.0).unwrap();
        tuning.learn([Alignment { reversed: true, ..Alignment::default() }; 2]);
        assert_eq!(tuning.save_learnt(), Ok(true));
        let stored = Settings::load(&mut tuning.store).unwrap().unwrap();
        let kept = (stored.aligned, stored.phases_reversed, stored.over_speed);
        assert_eq!(kept, ([1.0; 2], [1.0; 2], Settings::DEFAULT.over_speed));
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
        assert_eq!(Settings::load(&mut saved(&settings)), Ok(Some(settings)));
    }
}
