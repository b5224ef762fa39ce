//! ESP32: the fast loop has core 1 to itself; currents on ADC1.

use esp_hal::analog::adc::AdcCalLine;
use esp_hal::efuse::{ChipRevision, chip_revision};
use esp_hal::peripherals::{ADC1, GPIO34, GPIO35, GPIO36, GPIO39, LPWR, SENS};

use crate::choice::BOARD;

/// How a conversion becomes millivolts: by what the chip's fuses say of its own converter.
pub(super) type Calibration = AdcCalLine<ADC1<'static>>;

/// Amplifier of the top motor's phase A.
pub(super) type TopA = GPIO39<'static>;
/// Amplifier of the top motor's phase B.
pub(super) type TopB = GPIO36<'static>;
/// Amplifier of the bottom motor's phase A.
pub(super) type BottomA = GPIO35<'static>;
/// Amplifier of the bottom motor's phase B.
pub(super) type BottomB = GPIO34<'static>;
/// The divider option, which costs an amplifier.
pub(super) type Divider = GPIO34<'static>;

const _: () = {
    let [top, bottom] = BOARD.bridges;
    assert!(matches!(top.currents, None | Some([39, 36])), "the top currents are on 39 and 36");
    assert!(matches!(bottom.currents, None | Some([35, 34])), "the bottom ones on 35 and 34");
    assert!(matches!(BOARD.divider_option.pin, 34), "the divider option is on 34");
};

/// Returns why the fast loop cannot be trusted to this chip: before revision 3, a core that reads a peripheral while the
/// other one does can read something else (Espressif, ESP32 series SoC errata, CPU-3.10).
pub(crate) fn unsuitable() -> Option<&'static str> {
    (chip_revision() < ChipRevision::from_combined(300))
        .then_some("this ESP32 is older than revision 3 (erratum CPU-3.10): take a newer board")
}

/// Returns whether the converter is at work.
pub(super) fn is_converting() -> bool {
    SENS::regs().sar_slave_addr1().read().meas_status().bits() != 0
}

/// Lets a supply that sags reset the chip, which switches the bridges off.
pub(crate) fn reset_on_brown_out() {
    LPWR::regs().brown_out().modify(|_, w| {
        w.rst_ena().set_bit();
        w.ena().set_bit()
    });
}
