//! The battery and the bus that it feeds.
//!
//! An open-circuit voltage that falls with charge, behind one resistance, and the bridge's capacitor:
//!
//! ```text
//! C dV/dt = (V_open(charge) - V) / R_internal - I_bridge
//! ```
//!
//! The bus is solved exactly over a sub-step of constant bridge current. Current may flow back into a battery. It does
//! not into a bench supply: while the bus is above the supply's voltage, the capacitor alone takes what the bridges give.

/// Open-circuit voltage of one lithium-polymer cell at charge 0, 0.1, ... 1, V. Typical of hobby
/// cells at rest at room temperature.
const CELL_VOLTAGE: [f64; 11] = [3.27, 3.61, 3.69, 3.73, 3.77, 3.80, 3.84, 3.90, 3.98, 4.07, 4.20];

/// What a battery is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BatteryParameters {
    /// Cells in series.
    pub cells: u32,
    /// Charge when full, C.
    pub capacity: f64,
    /// Of cells, plug and leads together, ohm.
    pub resistance: f64,
    /// Capacitor across the bridge, F.
    pub bus_capacitance: f64,
    /// Whether current may flow back: into a battery, not into a bench supply.
    pub takes_charge: bool,
}

/// The paper's battery: 3 cells, 300 mAh (section II-A). Its resistance is assumed: 50 milliohm a cell, typical of
/// this size, and 30 for plug and leads. The capacitor is what driver boards of this class carry.
pub const PAPER_BATTERY: BatteryParameters = BatteryParameters {
    cells: 3,
    capacity: 0.300 * 3600.0,
    resistance: 3.0 * 0.050 + 0.030,
    bus_capacitance: 220e-6,
    takes_charge: true,
};

/// A battery with its bus.
#[derive(Debug, Clone)]
pub struct Battery {
    parameters: BatteryParameters,
    /// Charge left as a share of the capacity, 0 to 1.
    charge: f64,
    bus: f64,
    /// Added to the open-circuit voltage by a fault, V.
    disturbance: f64,
    delivered: f64,
    internal_loss: f64,
}

impl Battery {
    /// Creates a battery at rest at this share of its charge, 0 to 1.
    #[must_use]
    pub fn new(parameters: BatteryParameters, charge: f64) -> Self {
        let charge = charge.clamp(0.0, 1.0);
        let mut battery = Self {
            parameters,
            charge,
            bus: 0.0,
            disturbance: 0.0,
            delivered: 0.0,
            internal_loss: 0.0,
        };
        battery.bus = battery.open_circuit_voltage();
        battery
    }

    /// Returns the voltage without load at the present charge, V.
    #[must_use]
    pub fn open_circuit_voltage(&self) -> f64 {
        let position = self.charge * (CELL_VOLTAGE.len() - 1) as f64;
        let below = (position as usize).min(CELL_VOLTAGE.len() - 2);
        let share = position - below as f64;
        let cell = CELL_VOLTAGE[below] + share * (CELL_VOLTAGE[below + 1] - CELL_VOLTAGE[below]);
        f64::from(self.parameters.cells) * cell + self.disturbance
    }

    /// Returns the voltage at the bridge, V.
    #[must_use]
    pub fn bus_voltage(&self) -> f64 {
        self.bus
    }

    /// Returns the charge left, as a share of the capacity.
    #[must_use]
    pub fn charge(&self) -> f64 {
        self.charge
    }

    /// Returns the energy that its chemistry has given so far (less what it took back), J.
    #[must_use]
    pub fn delivered(&self) -> f64 {
        self.delivered
    }

    /// Returns the heat in the internal resistance so far, J.
    #[must_use]
    pub fn internal_loss(&self) -> f64 {
        self.internal_loss
    }

    /// Returns the energy in the bus capacitor, J.
    #[must_use]
    pub fn capacitor_energy(&self) -> f64 {
        0.5 * self.parameters.bus_capacitance * self.bus * self.bus
    }

    /// Adds this to the open-circuit voltage until changed again, V: a failing cell, a bad plug.
    pub fn disturb(&mut self, volts: f64) {
        self.disturbance = volts;
    }

    /// Charges it to this share of its capacity, 0 to 1.
    pub fn recharge(&mut self, charge: f64) {
        self.charge = charge.clamp(0.0, 1.0);
    }

    /// Lets the bridge draw `charge` coulombs from the bus during a sub-step.
    pub(super) fn draw(&mut self, charge: f64, bus_decay: &BusDecay) {
        let BusDecay { seconds, factor } = *bus_decay;
        let p = &self.parameters;
        let open = self.open_circuit_voltage();
        let alone = self.bus - charge / p.bus_capacitance;
        if !p.takes_charge && self.bus >= open && alone >= open {
            self.bus = alone;
            return;
        }
        let steady = open - p.resistance * charge / seconds;
        let after = steady + (self.bus - steady) * factor;
        // What the capacitor did not give came from the battery.
        let from_battery = charge + p.bus_capacitance * (after - self.bus);
        self.delivered += open * from_battery;
        self.internal_loss += self.loss(steady, open, bus_decay);
        self.charge = (self.charge - from_battery / p.capacity).clamp(0.0, 1.0);
        self.bus = after.max(0.0);
    }

    /// Integral of (V_open - V)^2 / R over a sub-step in which V decays towards `steady`.
    fn loss(&self, steady: f64, open: f64, bus_decay: &BusDecay) -> f64 {
        let time_constant = self.parameters.resistance * self.parameters.bus_capacitance;
        let (rest, swing) = (open - steady, self.bus - steady);
        let once = time_constant * (1.0 - bus_decay.factor);
        let twice = 0.5 * time_constant * (1.0 - bus_decay.factor * bus_decay.factor);
        (rest * rest * bus_decay.seconds - 2.0 * rest * swing * once + swing * swing * twice)
            / self.parameters.resistance
    }
}

/// How far the bus moves to its steady voltage in a sub-step.
#[derive(Debug, Clone, Copy)]
pub(super) struct BusDecay {
    seconds: f64,
    factor: f64,
}

impl BusDecay {
    pub(super) fn new(parameters: &BatteryParameters, seconds: f64) -> Self {
        let time_constant = parameters.resistance * parameters.bus_capacitance;
        Self { seconds, factor: libm::exp(-seconds / time_constant) }
    }
}
