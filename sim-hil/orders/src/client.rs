//! A client: the person's wish as an order, the permit that was shown, and what telemetry does to both.

use crate::model::{Change, Model};
use crate::network::Telemetry;
use crate::order::{Age, Order, Word};
use crate::robot::{Halt, Session};

/// A client of one operator.
#[derive(Clone, Copy, Debug, Default, Hash, PartialEq, Eq)]
pub struct Client {
    /// Its session, as the robot sees it.
    pub session: Session,
    /// Whether telemetry of this session was shown.
    pub has_telemetry: bool,
    /// Age of the permit that is shown.
    pub age: Age,
    /// Ghost: the robot has halted since the telemetry that is shown.
    pub is_unseen: bool,
    /// Whether a stop or a fault is shown.
    pub shows_ill: bool,
    /// Moment of the telemetry that is shown.
    pub newest: u8,
    /// The wish.
    pub order: Order,
    /// Counter of the first datagram with this `Stop`; 0 before.
    pub stop_since: u8,
    /// Ghost: the robot has received this `Stop`.
    pub is_stop_received: bool,
}

impl Client {
    /// Returns whether a press of `word` does anything: a wish that begins something needs a permit that is shown, `Clear` needs
    /// a stop or fault that is shown, and nothing replaces `Stop` before the robot has acknowledged it.
    pub(crate) fn takes(&self, model: &Model, word: Word) -> bool {
        let may_clear =
            self.shows_ill || model.has(Change::ClearUnasked) || model.has(Change::ClearDisarms);
        self.session != Session::None
            && self.order.word != Word::Stop
            && (self.has_telemetry || !word.needs_permit())
            && (word != Word::Clear || may_clear)
    }

    /// Takes the press of a person at the moment `now`.
    pub(crate) fn press(&mut self, word: Word, now: u8) {
        let (age, is_unseen) =
            if word.needs_permit() { (self.age, self.is_unseen) } else { Default::default() };
        self.order = Order { word, age, is_unseen, is_expired: false, pressed: now };
        (self.stop_since, self.is_stop_received) = (0, false);
    }

    /// Takes the press of a program that holds a permit for it.
    pub(crate) fn press_next(&mut self, word: Word, now: u8) {
        self.order = Order { word, pressed: now, ..self.order };
    }

    /// Shows telemetry, unless newer telemetry is shown. Returns whether the client calls its stop acknowledged.
    pub(crate) fn hear(&mut self, model: &Model, telemetry: &Telemetry) -> bool {
        if self.session != Session::Present || telemetry.moment < self.newest {
            return false;
        }
        self.show(telemetry);
        if self.order.word == Word::Stop {
            let is_heard = model.has(Change::AcknowledgedByFlag)
                || self.stop_since != 0 && telemetry.heard >= self.stop_since;
            if is_heard && telemetry.is_stopped {
                self.order = Order::default();
                (self.stop_since, self.is_stop_received) = (0, false);
                return true;
            }
            return false;
        }
        if self.order.word.needs_permit() || self.order.word == Word::Next {
            if self.order.age != telemetry.age {
                let is_renewed = model.has(Change::ClientRenewsPermit)
                    || self.order.word == Word::Next && model.has(Change::ProgramPressesShown);
                if is_renewed {
                    self.order.age = telemetry.age;
                } else {
                    self.withdraw(!telemetry.is_idle);
                }
            } else if self.order.word == Word::Clear
                && !telemetry.is_ill
                && !model.has(Change::ClearUnasked)
            {
                self.order = if model.has_programs {
                    Order { word: Word::Next, pressed: 0, ..self.order }
                } else {
                    Order::default()
                };
            }
        }
        false
    }

    /// Returns the client after a program has followed the permit of this telemetry; `None` where a program does not follow.
    ///
    /// A program follows a permit that is exactly the next after its own, and whose reason it awaits.
    pub(crate) fn followed(&self, model: &Model, telemetry: &Telemetry) -> Option<Self> {
        let is_next = self.order.age == telemetry.age.next() && self.order.age != telemetry.age;
        if self.session != Session::Present || telemetry.moment < self.newest || !is_next {
            return None;
        }
        let (word, is_asked) = match (self.order.word, telemetry.halt) {
            (Word::Arm, Halt::Aligned) => (Word::Walk, true),
            (Word::Arm, Halt::LetGo) => (Word::Arm, true),
            (Word::Try, Halt::LetGo) => (Word::Try, true),
            (Word::Try, Halt::Tried | Halt::Fault) if model.has(Change::TriesAgainUnasked) => {
                (Word::Try, false)
            }
            (Word::Try, Halt::Tried | Halt::Fault) => (Word::Next, true),
            (Word::Arm | Word::Walk, _) if model.has(Change::FollowsAnyReason) => {
                (Word::Walk, false)
            }
            (Word::Try, _) if model.has(Change::FollowsAnyReason) => (Word::Try, false),
            _ => return None,
        };
        let mut client = *self;
        client.show(telemetry);
        // A press answers for the halts that it awaits, and for no second trial.
        let is_unseen = if is_asked { telemetry.is_unseen } else { self.order.is_unseen };
        let pressed = if word == Word::Next { 0 } else { self.order.pressed };
        client.order = Order { word, age: telemetry.age, is_unseen, is_expired: false, pressed };
        Some(client)
    }

    /// Ends a wish whose permit is old, or whose patience is over. `is_driven`: an armed robot is held at rest.
    pub(crate) fn withdraw(&mut self, is_driven: bool) {
        let word = match self.order.word {
            Word::Walk => Word::Rest,
            Word::Arm if is_driven => return,
            Word::Arm | Word::Try | Word::Clear | Word::Next => Word::Off,
            _ => return,
        };
        self.order = Order::withdrawn(word);
    }

    fn show(&mut self, telemetry: &Telemetry) {
        self.has_telemetry = true;
        (self.age, self.is_unseen) = (telemetry.age, telemetry.is_unseen);
        (self.shows_ill, self.newest) = (telemetry.is_ill, telemetry.moment);
    }
}
