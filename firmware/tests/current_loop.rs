//! The current loop, in integers, against the same loop in double precision.

use flix_firmware::board::DENGFOC_V3_01;
use flix_firmware::fast::foc::current::{CurrentLoop, Input};
use flix_firmware::settings::Settings;
use std::f64::consts::TAU;

/// The loop as a book would write it: volts, amperes, radians.
#[derive(Default)]
struct Reference {
    integral: [f64; 2],
    limited: usize,
}

impl Reference {
    fn update(&mut self, input: &Input) -> [f64; 3] {
        let settings = Settings::DEFAULT.on(&DENGFOC_V3_01.hardware);
        let resistance = f64::from(settings.phase_resistance[0]);
        let inductance = f64::from(settings.phase_inductance[0]) * 1e-3;
        let flux = f64::from(settings.flux_linkage[0]) * 1e-3;
        let bandwidth = TAU * f64::from(settings.current_bandwidth);
        let angle = f64::from(input.angle.raw()) / 4_294_967_296.0 * TAU;
        let omega = f64::from(input.speed.raw()) / 4_294_967_296.0 * TAU * 1e4;
        let [reference_d, reference_q] = [input.reference.d, input.reference.q]
            .map(|current| f64::from(current.raw()) / 65_536.0);

        let [a, b] = input
            .phases
            .map(|phases| phases.map(|i| f64::from(i.raw()) / 65_536.0))
            .unwrap_or_default();
        let (alpha, beta) = (a, (a + 2.0 * b) / 3_f64.sqrt());
        let (sine, cosine) = angle.sin_cos();
        let d = alpha * cosine + beta * sine;
        let q = beta * cosine - alpha * sine;
        let errors = [reference_d - d, reference_q - q];
        let feed_forward = [
            resistance * reference_d - omega * inductance * reference_q,
            resistance * reference_q + omega * inductance * d + omega * flux,
        ];
        let mut voltages = [0.0; 2];
        for axis in 0..2 {
            voltages[axis] =
                inductance * bandwidth * errors[axis] + self.integral[axis] + feed_forward[axis];
        }
        let limit = 0.6 * crate::rows::BUS;
        let given_d = voltages[0].clamp(-limit / 2.0, limit / 2.0);
        let room = (limit * limit - given_d * given_d).sqrt();
        let given = [given_d, voltages[1].clamp(-room, room)];
        self.limited += usize::from(given != voltages);
        for axis in 0..2 {
            self.integral[axis] +=
                resistance * bandwidth / 1e4 * errors[axis] + (given[axis] - voltages[axis]) / 4.0;
        }

        let ahead = angle + omega * f64::from(settings.actuation_delay) * 1e-6;
        let (sine, cosine) = ahead.sin_cos();
        let (alpha, beta) =
            (given[0] * cosine - given[1] * sine, given[0] * sine + given[1] * cosine);
        let half = beta * 3_f64.sqrt() / 2.0;
        let lost = crate::rows::BUS * crate::rows::DEAD_SHARE;
        let slope = f64::from(crate::rows::model().dead_time) / 16_777_216.0;
        let dead = |current: f64| (slope * current).clamp(-lost, lost);
        let phases =
            [alpha + dead(a), half - alpha / 2.0 + dead(b), -half - alpha / 2.0 + dead(-a - b)];
        let most = phases.iter().fold(f64::MIN, |most, phase| most.max(*phase));
        let least = phases.iter().fold(f64::MAX, |least, phase| least.min(*phase));
        phases
            .map(|phase| ((phase - (most + least) / 2.0) / crate::rows::BUS + 0.5).clamp(0.0, 1.0))
    }
}

#[test]
fn duties_are_those_of_double_precision_within_a_thousandth() {
    let (model, bus) = (crate::rows::model(), crate::rows::bus());
    let (mut fixed, mut reference) = (CurrentLoop::default(), Reference::default());
    let mut worst = 0.0_f64;
    for input in crate::rows::rows() {
        let duties = fixed.update(&model, &bus, &input);
        for (duty, expected) in duties.into_iter().zip(reference.update(&input)) {
            worst = worst.max((f64::from(duty.raw()) / 65_536.0 - expected).abs());
        }
    }
    println!(
        "largest duty error {worst:.6}, {} of {} rows at the voltage limit",
        reference.limited,
        crate::rows::COUNT
    );
    assert!(worst < 1e-3, "{worst}");
    assert!((500..9_500).contains(&reference.limited), "{}", reference.limited);
}
