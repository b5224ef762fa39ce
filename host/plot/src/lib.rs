#![forbid(unsafe_code)]
//! Figures: the same picture as SVG and PNG, on any machine.
//!
//! A figure is plain data ([`Chart`], [`Track`], [`HeatMaps`]) that draws itself once, onto a [`Canvas`]. SVG and PNG
//! are written from its shapes, the PNG with an embedded font (DejaVu Sans): both files show the same picture, also on a
//! machine without fonts. Only
//! [`record`] and [`scope`] decide what to show, of runs and of captures.
//!
//! Lengths inside a figure are logical pixels (CSS pixels of the SVG); the PNG has [`PNG_DENSITY`]
//! pixels for each. Data are in the unit that the label of the axis names; points that are not finite
//! break a line.
//!
//! ```
//! use flix_plot::{Chart, Figure, Panel, Series, colour};
//!
//! let sine = (0..200).map(|i| f64::from(i) * 0.05).map(|t| (t, t.sin()));
//! let figure = Chart::new("A sine", "Time (s)")
//!     .panel(Panel::new("Amplitude (V)").series(Series::line("sine", sine).colour(colour::BLUE)));
//! assert!(figure.svg().starts_with("<svg"));
//! ```

mod axis;
mod canvas;
mod chart;
pub mod colour;
mod heatmap;
mod raster;
pub mod record;
pub mod scope;
mod series;
mod svg;
mod track;

use std::io::Write as _;
use std::path::{Path, PathBuf};

use flix_host::system::file;

pub use axis::Limits;
pub use canvas::{Canvas, Size};
pub use chart::{Chart, Panel};
pub use colour::Colour;
pub use heatmap::{HeatMap, HeatMaps, Palette};
pub use raster::PNG_DENSITY;
pub use series::{Point, Series, Stroke};
pub use track::{Mark, Outline, Track};

/// Why a figure was not made.
#[derive(Debug, thiserror::Error)]
pub enum PlotError {
    /// The page could not be drawn in pixels.
    #[error("the figure could not be converted to PNG: {0}")]
    Rasterise(String),
    /// A file or folder could not be written.
    #[error("cannot write {}: {source}; check that the folder exists and may be written to", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
}

/// The two files of [`Figure::write`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Written {
    /// The vector picture.
    pub svg: PathBuf,
    /// The same picture in pixels.
    pub png: PathBuf,
}

/// A picture that can be drawn.
pub trait Figure {
    /// Returns width and height.
    fn size(&self) -> Size;

    /// Draws everything onto an empty white canvas of [`size`](Self::size).
    fn draw(&self, canvas: &mut Canvas);

    /// Returns the page with everything on it.
    fn page(&self) -> Canvas {
        let mut canvas = Canvas::new(self.size());
        self.draw(&mut canvas);
        canvas
    }

    /// Returns the picture as one SVG document.
    fn svg(&self) -> String {
        svg::document(&self.page())
    }

    /// Returns the picture as PNG, with [`PNG_DENSITY`] pixels for each logical pixel.
    ///
    /// # Errors
    /// When the picture is too large.
    fn png(&self) -> Result<Vec<u8>, PlotError> {
        raster::png(&self.page()).map_err(PlotError::Rasterise)
    }

    /// Writes `name.svg` and `name.png` into `folder`, which is created if it is missing. Replaces links of these
    /// names, and follows none.
    ///
    /// # Errors
    /// When a file cannot be written.
    fn write(&self, folder: &Path, name: &str) -> Result<Written, PlotError> {
        let written = Written {
            svg: folder.join(format!("{name}.svg")),
            png: folder.join(format!("{name}.png")),
        };
        let failed = |path: &Path| {
            let path = path.to_owned();
            move |source| PlotError::Write { path, source }
        };
        let page = self.page();
        std::fs::create_dir_all(folder).map_err(failed(folder))?;
        let write = |path: &Path, bytes: &[u8]| {
            file::replace(path, |mut file| file.write_all(bytes)).map_err(failed(path))
        };
        write(&written.svg, svg::document(&page).as_bytes())?;
        write(&written.png, &raster::png(&page).map_err(PlotError::Rasterise)?)?;
        Ok(written)
    }
}

#[cfg(test)]
mod tests;
#[cfg(test)]
#[path = "../../tests/support/walked.rs"]
mod walked;
