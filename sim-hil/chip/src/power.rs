//! Power that goes within a flash operation: each write and each erase of provisioning a new robot, of provisioning it
//! anew, and of saving its settings is cut, and the robot that then starts must have the old or the new, whole.

use flix_firmware::board::EncoderKind;
use flix_protocol::message::{Command, Fault, Outcome, ParameterCommand};
use flix_protocol::provision::{Answer, Request};
use flix_protocol::session::Key;
use serde::Serialize;

use crate::chip::ResetReason;
use crate::flash::{Flash, Operation};
use crate::image::{Image, STORE};
use crate::rig::{Rig, RigError};

/// How much of an operation is done when power goes.
const SHARE: f64 = 0.5;
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
    progress: &'a dyn Fn(&str),
    cuts: Cuts,
}

impl Subject<'_> {
    fn start(&self, flash: Flash) -> Rig {
        Rig::with_flash(self.image.clone(), self.encoder, self.seed, flash)
    }

    /// Does `work` with a robot, then cuts it in the operations of it and looks what is kept.
    ///
    /// `work` returns how many operations were done when it was acknowledged: from there on only the new counts.
    fn cut(
        &mut self,
        what: &str,
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
        for number in (0..operations.len()).step_by(self.stride.max(1)) {
            let of = operations.len();
            (self.progress)(&format!("power cut in operation {} of {of} of {what}", number + 1));
            self.cuts.cuts += 1;
            let mut rig = self.start(before.cut(&operations[..=number], SHARE));
            let found = kept(&mut rig);
            let is_right = match found {
                Ok(Kept::New) => true,
                Ok(Kept::Old) => number < acknowledged,
                _ => false,
            };
            if !is_right {
                self.cuts.lost += 1;
                self.cuts.failures.push(match found {
                    Ok(kept) => format!("{what}: {kept:?} after a cut in operation {number}"),
                    Err(error) => format!("{what}: {error} after a cut in operation {number}"),
                });
            }
        }
        Ok(rig.chip.flash().clone())
    }
}

/// Cuts power in every `stride`-th flash operation. `progress` is given a line before each cut.
///
/// # Errors
/// When the robot does not do without cuts what is then cut.
pub fn cut_all(
    image: &Image,
    encoder: EncoderKind,
    seed: u64,
    stride: usize,
    progress: &dyn Fn(&str),
) -> Result<Cuts, RigError> {
    let mut subject = Subject { image, encoder, seed, stride, progress, cuts: Cuts::default() };
    let empty = crate::image::programmed_flash();
    let provision = |key: [u8; 32]| {
        move |rig: &mut Rig| {
            rig.key = Key::new(key);
            let provisioning = rig.provisioning("walker")?;
            rig.ask_serial(&Request::Provision(provisioning, rig.operator()))?;
            let acknowledged = rig.chip.flash().operations().len();
            rig.until_log("connection to the network", "wi-fi: connected")?;
            Ok(acknowledged)
        }
    };
    let [first, second] = KEYS;
    let provisioned =
        subject.cut("provisioning", &empty, provision(first), |rig| key_of(rig, None, first))?;
    let renewed = subject.cut("provisioning anew", &provisioned, provision(second), |rig| {
        key_of(rig, Some(first), second)
    })?;
    if is_stored(&renewed, first) || !is_stored(&renewed, second) {
        let sentence = "of the former and the new key flash is to hold the new one alone";
        subject.cuts.failures.push(sentence.to_owned());
    }
    // A handful.
    subject.stride = 1;
    subject.cut("saving settings", &provisioned, save_settings, setting_of)?;
    Ok(subject.cuts)
}

fn is_stored(flash: &Flash, key: [u8; 32]) -> bool {
    flash.cells()[STORE].windows(key.len()).any(|bytes| bytes == key)
}

/// Which key the robot has, by its proof over the serial port.
fn key_of(rig: &mut Rig, old: Option<[u8; 32]>, new: [u8; 32]) -> Result<Kept, RigError> {
    let Answer::Identity { has_key, .. } = rig.ask_serial(&Request::Identify)? else {
        return Err(RigError::OtherAnswer);
    };
    if rig.log().contains("provision the robot again") {
        return Ok(Kept::Neither);
    }
    let mut is_proved = |key: [u8; 32]| {
        let key = Key::new(key);
        match rig.ask_serial(&Request::Prove(CHALLENGE, key.id()))? {
            Answer::Proof(proof) => Ok(proof.is_some_and(|it| key.is_proved(&CHALLENGE, &it))),
            _ => Err(RigError::OtherAnswer),
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
fn save_settings(rig: &mut Rig) -> Result<usize, RigError> {
    let (name, value) = SETTING;
    let name = name.try_into().map_err(|_| RigError::OtherAnswer)?;
    rig.until_log("connection to the network", "wi-fi: connected")?;
    rig.connect()?;
    for command in [ParameterCommand::Set(name, value), ParameterCommand::Save] {
        if let Outcome::Refused(refusal) = rig.ask(Command::Parameter(command))? {
            return Err(RigError::Refused(refusal));
        }
    }
    Ok(rig.chip.flash().operations().len())
}

/// Which value the setting has.
fn setting_of(rig: &mut Rig) -> Result<Kept, RigError> {
    rig.until_log("connection to the network", "wi-fi: connected")?;
    rig.connect()?;
    let (name, new) = SETTING;
    let value = rig.setting(name)?;
    let is_unreadable =
        rig.telemetry.is_some_and(|telemetry| telemetry.first_fault == Some(Fault::Settings));
    Ok(match value == f64::from(new) {
        _ if is_unreadable => Kept::Neither,
        true => Kept::New,
        false => Kept::Old,
    })
}
