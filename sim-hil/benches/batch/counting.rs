//! Numbers that count what is done with them.

use core::cell::Cell;
use core::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

use flix_sim::model::RobotModel;
use flix_sim::plant::mechanics::lane::Lane;
use flix_sim::plant::mechanics::{Block, Pack, Robots as _};
use flix_sim::plant::{Drive, Plant};

thread_local! {
    static DONE: Cell<u64> = const { Cell::new(0) };
}

/// A number whose additions, multiplications, divisions and roots are counted.
#[derive(Debug, Clone, Copy)]
struct Counting(f64);

fn counted(value: f64) -> Counting {
    DONE.set(DONE.get() + 1);
    Counting(value)
}

macro_rules! operators {
    ($($trait:ident $method:ident $op:tt)+) => {$(
        impl $trait for Counting {
            type Output = Self;
            fn $method(self, o: Self) -> Self {
                counted(self.0 $op o.0)
            }
        }
    )+};
}
operators! { Add add + Sub sub - Mul mul * Div div / }

impl Neg for Counting {
    type Output = Self;
    fn neg(self) -> Self {
        Self(-self.0)
    }
}
impl AddAssign for Counting {
    fn add_assign(&mut self, o: Self) {
        *self = *self + o;
    }
}
impl SubAssign for Counting {
    fn sub_assign(&mut self, o: Self) {
        *self = *self - o;
    }
}

impl Lane for Counting {
    const LANES: usize = 1;
    const SHORT: bool = false;
    fn splat(value: f64) -> Self {
        Self(value)
    }
    fn lane(self, _: usize) -> f64 {
        self.0
    }
    fn with_lane(self, _: usize, value: f64) -> Self {
        Self(value)
    }
    fn negative_then(self, yes: Self, no: Self) -> Self {
        if self.0 < 0.0 { yes } else { no }
    }
    fn sqrt(self) -> Self {
        counted(self.0.sqrt())
    }
    fn round(self) -> Self {
        DONE.set(DONE.get() + 1);
        counted(self.0.round_ties_even())
    }
    fn any_negative(self) -> bool {
        self.0 < 0.0
    }
    fn less_quarter_turns(self, quarters: Self) -> Self {
        DONE.set(DONE.get() + 3);
        counted(f64::less_quarter_turns(self.0, quarters.0))
    }
}

impl Pack for Counting {
    type Single = f64;
    fn all(single: &f64) -> Self {
        Self(*single)
    }
    fn set(&mut self, _: usize, single: &f64) {
        self.0 = *single;
    }
    fn get(&self, _: usize) -> f64 {
        self.0
    }
}

/// Returns the mean of a robot that walks at 30 Hz alone.
pub fn operations_of_a_step(model: &RobotModel, step: f64) -> f64 {
    const STEPS: usize = 2000;
    let mut plant = Plant::new(model).expect("shipped models are valid");
    plant.disturb(1, false);
    plant.set_drive(Drive::Ideal { frequency_hz: 30.0, theta_rad: 0.5 });
    let mut block = Block::<Counting>::new(model, &plant).expect("shipped models walk");
    block.run(1000, step);
    DONE.set(0);
    block.run(STEPS, step);
    DONE.get() as f64 / STEPS as f64
}
