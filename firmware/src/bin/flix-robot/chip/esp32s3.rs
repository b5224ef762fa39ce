//! ESP32-S3: the fast loop has core 1 to itself; currents on ADC1.

use esp_hal::analog::adc::AdcCalCurve;
use esp_hal::peripherals::{ADC1, GPIO1, GPIO2, GPIO4, GPIO5, GPIO6, LPWR, SENS};

use crate::choice::BOARD;

/// How a conversion becomes millivolts: by what the chip's fuses say of its own converter.
pub(super) type Calibration = AdcCalCurve<ADC1<'static>>;

/// Amplifier of the top motor's phase A.
pub(super) type TopA = GPIO1<'static>;
/// Amplifier of the top motor's phase B.
pub(super) type TopB = GPIO2<'static>;
/// Amplifier of the bottom motor's phase A.
pub(super) type BottomA = GPIO4<'static>;
/// Amplifier of the bottom motor's phase B.
pub(super) type BottomB = GPIO5<'static>;
/// The divider option.
pub(super) type Divider = GPIO6<'static>;

const _: () = {
    let [top, bottom] = BOARD.bridges;
    assert!(matches!(top.currents, None | Some([1, 2])), "the top currents are on 1 and 2");
    assert!(matches!(bottom.currents, None | Some([4, 5])), "the bottom ones on 4 and 5");
    assert!(matches!(BOARD.divider_option.pin, 6), "the divider option is on 6");
};

/// Every revision will do.
pub(crate) const fn unsuitable() -> Option<&'static str> {
    None
}

/// Returns whether the converter is at work.
pub(super) fn is_converting() -> bool {
    SENS::regs().sar_slave_addr1().read().sar_saradc_meas_status().bits() != 0
}

/// Lets a supply that sags reset the chip, which switches the bridges off.
pub(crate) fn reset_on_brown_out() {
    LPWR::regs().brown_out().modify(|_, w| {
        w.brown_out_rst_ena().set_bit();
        w.brown_out_ena().set_bit()
    });
}
