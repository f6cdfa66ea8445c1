//! Pictures of a run as SVG: the events of a cycle ([`cycle`]), a series over time ([`series`]),
//! states of devices ([`states`]), counts by size (`bars`), digital signals ([`waves`]), the tree
//! of a segment ([`topology`]).
//!
//! One drawing serves all uses: a report embeds it with zoom, documentation stores it as a file, a
//! page in a browser redraws it. So a picture is plain text without a script, colours are names of
//! its style (`picture/style.css`, light and dark), and every element with a figure has it as its
//! title. The group `stretch` may be stretched along the axis of time; texts with the class `moves`
//! keep their shape and move along.

pub(crate) mod bars;
pub mod cycle;
mod frame;
pub mod margin;
pub mod segment;
pub mod series;
pub mod states;
#[cfg(test)]
mod tests;
pub mod topology;
pub mod waves;

pub use frame::{Align, Frame};
pub use isocat_descriptions::markup::escaped as escape;

/// Colours and fonts of all pictures.
pub const STYLE: &str = include_str!("picture/style.css");

/// A script for a page with pictures: `isocatZoom.Zoom` zooms one.
pub const ZOOM: &str = include_str!("picture/zoom.js");

/// A drawing.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Picture {
    /// Width, in units of the drawing.
    pub width: u32,
    /// Height, in units of the drawing.
    pub height: u32,
    /// Its description, for readers who cannot see it.
    pub title: String,
    /// Attributes of the outermost element besides its size.
    pub attributes: String,
    /// Its content as SVG.
    pub body: String,
}

impl Picture {
    /// The SVG element, for a page with [`STYLE`].
    pub fn svg(&self) -> String {
        let Self { width, height, title, attributes, body } = self;
        let title = escape(title);
        format!(
            "<svg class=\"picture\" viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"{title}\"{attributes}>\n\
             {body}</svg>"
        )
    }

    /// A separate SVG file.
    pub fn file(&self) -> String {
        let Self { width, height, title, body, .. } = self;
        let title = escape(title);
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" class=\"picture\" width=\"{width}\" height=\"{height}\" \
             viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"{title}\">\n<title>{title}</title>\n\
             <style>\n{STYLE}</style>\n<rect class=\"paper\" width=\"{width}\" height=\"{height}\"/>\n{body}</svg>\n"
        )
    }
}

/// A number for SVG with two decimals: a hundredth of a pixel.
pub(crate) fn number(value: f64) -> String {
    let mut text = format!("{value:.2}");
    text.truncate(text.trim_end_matches('0').trim_end_matches('.').len());
    if text == "-0" { "0".into() } else { text }
}
