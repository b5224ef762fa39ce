//! Colours that are distinct on paper, on screens and for colour-blind readers: any two of a plot differ by 10 or more (CIEDE2000),
//! also for eyes without one kind of cones.

use std::fmt;

/// Red, green, blue, each 0 to 255.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Colour(pub u8, pub u8, pub u8);

/// First choice of a series.
pub const BLUE: Colour = Colour(0x1e, 0x72, 0xff);
/// Second choice of a series.
pub const ORANGE: Colour = Colour(0xe6, 0x6a, 0x00);
/// Third choice of a series.
pub const GREEN: Colour = Colour(0x27, 0x8c, 0x6d);
/// A limit, a fault, a stop.
pub const RED: Colour = Colour(0xd1, 0x19, 0x3a);
/// Fourth choice of a series.
pub const PURPLE: Colour = Colour(0x6b, 0x45, 0xbb);
/// Fifth choice of a series.
pub const SKY: Colour = Colour(0x01, 0xa0, 0xcc);
/// Sixth choice of a series.
pub const OLIVE: Colour = Colour(0x99, 0x96, 0x5c);
/// Seventh choice of a series.
pub const PINK: Colour = Colour(0xc8, 0x58, 0x9f);
/// Eighth choice of a series.
pub const BROWN: Colour = Colour(0x7d, 0x4a, 0x10);
/// A reference or a set value.
pub const GREY: Colour = Colour(0x8a, 0x93, 0x9f);
/// What is commanded, here, on the pages and in Foxglove.
pub const COMMANDED: Colour = GREY;
/// f and theta as they are measured, here, on the pages and in Foxglove.
pub const MEASURED: Colour = ORANGE;
/// Text.
pub const INK: Colour = Colour(0x1c, 0x23, 0x2e);
/// Labels of axes and other quiet text.
pub const MUTED: Colour = Colour(0x5b, 0x65, 0x73);
/// The frame of a plot.
pub const FRAME: Colour = Colour(0xb6, 0xbd, 0xc7);
/// The grid.
pub const GRID: Colour = Colour(0xe7, 0xea, 0xee);
/// Paper.
pub const WHITE: Colour = Colour(0xff, 0xff, 0xff);

/// The colours of series, in turn: one for each walking mode of the paper's table III.
pub const CYCLE: [Colour; 9] = [BLUE, ORANGE, GREEN, PURPLE, RED, SKY, OLIVE, PINK, BROWN];

impl fmt::Display for Colour {
    /// Writes `#rrggbb`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "#{:02x}{:02x}{:02x}", self.0, self.1, self.2)
    }
}

impl Colour {
    /// Returns the colour `share` (0 to 1) of the way from this one to `other`.
    #[must_use]
    pub fn towards(self, other: Colour, share: f64) -> Colour {
        let blend = |a: u8, b: u8| {
            (f64::from(a) + (f64::from(b) - f64::from(a)) * share.clamp(0.0, 1.0)).round() as u8
        };
        Colour(blend(self.0, other.0), blend(self.1, other.1), blend(self.2, other.2))
    }

    /// Returns the relative luminance, 0 (black) to 1 (white).
    #[must_use]
    pub(crate) fn luminance(self) -> f64 {
        // Rec. 709 weights on gamma-encoded values: near enough to choose the ink.
        (0.2126 * f64::from(self.0) + 0.7152 * f64::from(self.1) + 0.0722 * f64::from(self.2))
            / 255.0
    }

    /// Returns a colour in which text is legible on this colour.
    #[must_use]
    pub(crate) fn ink(self) -> Colour {
        if self.luminance() > 0.55 { INK } else { WHITE }
    }
}
