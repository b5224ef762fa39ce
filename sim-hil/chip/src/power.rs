//! Power that goes within a flash operation: each write and each erase of provisioning a new robot, of provisioning it
//! anew, and of saving its settings is cut, erasures at several shares, and the robot that then starts must have the old or
//! the new, whole; as must the one that starts again after cells faded that were left half-way. What it saves later
//! it must have after two more starts.

use flix_firmware::board::EncoderKind;
use flix_host::link::{LinkError, RobotLink};
use flix_protocol::message::{Command, Fault, ParameterCommand};
use flix_protocol::provision::{Answer, Request};
use flix_protocol::session::Key;
use serde::Serialize;

use crate::rig::{Rig, RigError};
use flix_esp32c6::chip::ResetReason;
use flix_esp32c6::flash::{Flash, Operation};
use flix_esp32c6::image::{Image, STORE};

/// How much of a write is done when power goes.
const WRITTEN: [f64; 1] = [0.5];
/// How much of an erasure is done when power goes: nothing yet at first, at last every cell reads as erased.
const ERASED: [f64; 6] = [0.0, 0.02, 0.5, 0.95, 0.999, 1.0];
/// Of these, in the short form.
const QUICK_ERASED: [f64; 3] = [0.0, 0.5, 0.999];
/// So many saves have written to every sector of the store.
const SECTORS: usize = 6;
/// Chance that a cell fades before a start whose change was cut.
const FADING: f64 = 0.5;
/// Another value of [`SETTING`], saved after a cut and two starts.
const LATER: f32 = 1.2;
/// A setting and another value than its default.
const SETTING: (&str, f32) = ("current_limit", 1.5);
/// Keys: before and after provisioning anew.
const KEYS: [[u8; 32]; 2] = [[7; 32], [8; 32]];
const CHALLENGE: [u8; 16] = [0x5A; 16];

/// What became of the cuts.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Cuts {
    /// Operations in which power went.
    pub cuts: usize,
    /// Of these, those after which the robot had neither the old nor the new.
    pub lost: usize,
    /// Sentences about these.
    pub failures: Vec<String>,
}

/// What a robot has after a cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kept {
    Old,
    New,
    /// The new, with the old still in flash.
    Both,
    Neither,
}

/// A robot that is started again and again, and what became of it so far.
struct Subject<'a> {
    image: &'a Image,
    encoder: EncoderKind,
    seed: u64,
    stride: usize,
    erased: &'static [f64],
    until_failure: bool,
    progress: &'a dyn Fn(&str),
    cuts: Cuts,
}

impl Subject<'_> {
    fn start(&self, flash: Flash) -> Rig {
        Rig::with_flash(self.image.clone(), self.encoder, self.seed, flash)
    }

    /// Whether enough was found out.
    fn is_over(&self) -> bool {
        self.until_failure && !self.cuts.failures.is_empty()
    }

    /// Does `work` with a robot, then cuts it in the operations of it and looks what is kept.
    ///
    /// With `saves_later` each robot whose erasure was cut saves another value in the end, and keeps it.
    ///
    /// `work` returns how many operations were done when it was acknowledged: from there on only the new counts.
    fn cut(
        &mut self,
        (what, saves_later): (&str, bool),
        before: &Flash,
        work: impl FnOnce(&mut Rig) -> Result<usize, RigError>,
        kept: impl Fn(&mut Rig) -> Result<Kept, RigError>,
    ) -> Result<Flash, RigError> {
        let mut rig = self.start(before.clone());
        let acknowledged = work(&mut rig)?;
        self.cuts.failures.extend(rig.findings());
        let unasked = rig.resets.iter().filter(|(_, reason)| *reason != ResetReason::Software);
        let sentence =
            |(at, reason): &(_, _)| format!("{what}: a reset by {reason:?} after {at:?}");
        self.cuts.failures.extend(unasked.map(sentence));
        let operations: Vec<Operation> = rig.chip.flash().operations().to_vec();
        let is_cut = |number: &usize| {
            let is_erasure = matches!(operations[*number], Operation::Erase { .. });
            is_erasure || number.is_multiple_of(self.stride.max(1))
        };
        let numbers: Vec<usize> = (0..operations.len()).filter(is_cut).collect();
        for number in numbers {
            let of = operations.len();
            (self.progress)(&format!("power cut in operation {} of {of} of {what}", number + 1));
            let is_write = matches!(operations[number], Operation::Program { .. });
            let shares = if is_write { &WRITTEN } else { self.erased };
            for share in shares {
                if self.is_over() {
                    return Ok(rig.chip.flash().clone());
                }
                self.cuts.cuts += 1;
                let mut flash = before.cut(&operations[..=number], *share);
                for start in ["first", "second"] {
                    let mut rig = self.start(flash);
                    let found = kept(&mut rig);
                    let is_right = match found {
                        Ok(Kept::New) => true,
                        Ok(Kept::Old) => number < acknowledged,
                        _ => false,
                    };
                    if !is_right {
                        let found = found.map_or_else(|it| it.to_string(), |it| format!("{it:?}"));
                        self.cuts.lost += 1;
                        self.cuts.failures.push(format!(
                            "{what}: {found} at the {start} start after a cut in operation {number} at {share}"
                        ));
                        break;
                    }
                    flash = rig.chip.flash().clone();
                    flash.fade(FADING);
                }
                if saves_later && !is_write {
                    // Cells may begin to fade only once they were written again.
                    let flash = before.cut(&operations[..=number], *share);
                    let what = format!("{what}, cut in operation {number} at {share}");
                    self.save_later(flash, &what);
                }
            }
        }
        Ok(rig.chip.flash().clone())
    }

    /// Saves settings until every sector of the store was written to; returns the flash.
    fn use_store(&mut self, flash: &Flash) -> Result<Flash, RigError> {
        let mut rig = self.start(flash.clone());
        connect(&mut rig)?;
        for number in 0..SECTORS {
            set_and_save(&mut rig, LATER + number as f32 / 100.0)?;
        }
        Ok(rig.chip.flash().clone())
    }

    /// Saves another value with a robot that has this flash, then starts it twice, cells fading before.
    fn save_later(&mut self, flash: Flash, what: &str) {
        let mut rig = self.start(flash);
        let mut outcome = save_setting(&mut rig, LATER).map(|_| f64::from(LATER));
        for _ in 0..2 {
            let mut flash = rig.chip.flash().clone();
            flash.fade(FADING);
            rig = self.start(flash);
            outcome = outcome.and_then(|_| value_of(&mut rig));
        }
        if outcome != Ok(f64::from(LATER)) {
            self.cuts.lost += 1;
            let sentence = format!("{what}: what was saved later is {outcome:?} after two starts");
            self.cuts.failures.push(sentence);
        }
    }
}

/// Cuts power in every `stride`-th flash operation, or in those until the first failure alone. `progress` is given a line before each cut.
pub fn cut_all(
    image: &Image,
    encoder: EncoderKind,
    seed: u64,
    stride: usize,
    until_failure: bool,
    progress: &dyn Fn(&str),
) -> Result<Cuts, RigError> {
    let cuts = Cuts::default();
    let erased: &[f64] = if stride == 1 || until_failure { &ERASED } else { &QUICK_ERASED };
    let mut subject =
        Subject { image, encoder, seed, stride, erased, until_failure, progress, cuts };
    let empty = flix_esp32c6::image::programmed_flash();
    let provision = |key: [u8; 32]| {
        move |rig: &mut Rig| {
            rig.key = Key::new(key);
            let provisioning = rig.provisioning(Some(rig.lease()))?;
            rig.ask_serial(&Request::Provision(provisioning, rig.operator()))?;
            let acknowledged = rig.chip.flash().operations().len();
            rig.until_log("connection to the network", "wi-fi: connected")?;
            Ok(acknowledged)
        }
    };
    let [first, second] = KEYS;
    let provisioned = subject
        .cut(("provisioning", false), &empty, provision(first), |rig| key_of(rig, None, first))?;
    let renewed =
        subject.cut(("provisioning anew", false), &provisioned, provision(second), |rig| {
            key_of(rig, Some(first), second)
        })?;
    if is_stored(&renewed, first) || !is_stored(&renewed, second) {
        let sentence = "of the former and the new key flash is to hold the new one alone";
        subject.cuts.failures.push(sentence.to_owned());
    }
    if subject.is_over() {
        return Ok(subject.cuts);
    }
    // A handful.
    subject.stride = 1;
    let used = subject.use_store(&provisioned)?;
    let save = |rig: &mut Rig| save_setting(rig, SETTING.1);
    subject.cut(("saving settings", true), &used, save, setting_of)?;
    Ok(subject.cuts)
}

fn is_stored(flash: &Flash, key: [u8; 32]) -> bool {
    flash.cells()[STORE].windows(key.len()).any(|bytes| bytes == key)
}

/// The key that the robot has, by its proof over the serial port.
fn key_of(rig: &mut Rig, old: Option<[u8; 32]>, new: [u8; 32]) -> Result<Kept, RigError> {
    let Answer::Identity { has_key, .. } = rig.ask_serial(&Request::Identify)? else {
        return Err(LinkError::OtherAnswer.into());
    };
    if rig.log().contains("provision the robot again") {
        return Ok(Kept::Neither);
    }
    let mut is_proved = |key: [u8; 32]| -> Result<bool, RigError> {
        let key = Key::new(key);
        match rig.ask_serial(&Request::Prove(CHALLENGE, key.id()))? {
            Answer::Proof(proof) => Ok(proof.is_some_and(|it| key.is_proved(&CHALLENGE, &it))),
            _ => Err(LinkError::OtherAnswer.into()),
        }
    };
    let is_new = is_proved(new)?;
    let is_old = old.map(&mut is_proved).transpose()?;
    let is_old_stored = old.is_some_and(|old| is_stored(rig.chip.flash(), old));
    Ok(match (is_new, is_old) {
        (true, Some(false)) if is_old_stored => Kept::Both,
        (true, None | Some(false)) => Kept::New,
        (false, Some(true)) => Kept::Old,
        (false, None) if !has_key => Kept::Old,
        _ => Kept::Neither,
    })
}

/// Connects, changes a setting and saves it.
fn save_setting(rig: &mut Rig, value: f32) -> Result<usize, RigError> {
    connect(rig)?;
    set_and_save(rig, value)
}

fn connect(rig: &mut Rig) -> Result<(), RigError> {
    rig.until_log("connection to the network", "wi-fi: connected")?;
    rig.connect()
}

/// Changes a setting and saves it; returns how many flash operations were done by then.
fn set_and_save(rig: &mut Rig, value: f32) -> Result<usize, RigError> {
    rig.set(SETTING.0, value)?;
    rig.ask(Command::Parameter(ParameterCommand::Save))?;
    Ok(rig.chip.flash().operations().len())
}

/// Connects and asks for the setting.
fn value_of(rig: &mut Rig) -> Result<f64, RigError> {
    connect(rig)?;
    rig.setting(SETTING.0)
}

/// The value that the setting has.
fn setting_of(rig: &mut Rig) -> Result<Kept, RigError> {
    let (_, new) = SETTING;
    let value = value_of(rig)?;
    let is_unreadable =
        rig.telemetry().is_some_and(|telemetry| telemetry.first_fault == Some(Fault::Settings));
    Ok(match value == f64::from(new) {
        _ if is_unreadable => Kept::Neither,
        true => Kept::New,
        false => Kept::Old,
    })
}
