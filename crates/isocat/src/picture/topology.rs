//! The tree of a segment with its delays: one line for each SubDevice, in processing order.

use std::fmt::Write;

use super::{Picture, escape, number};

/// A SubDevice in the tree.
#[derive(Clone, PartialEq, Debug)]
pub struct Node {
    /// Its name.
    pub name: String,
    /// Its parent, which comes earlier in the list; `None`: the MainDevice.
    pub parent: Option<usize>,
    /// Port of its parent, if known.
    pub port: Option<u8>,
    /// Whether it has the reference clock.
    pub leads: bool,
    /// Whether it has a fault.
    pub bad: bool,
    /// Propagation delay from the reference clock, ns; negative before it.
    pub delay: Option<f64>,
    /// Half the width of the interval that contains it, ns.
    pub delay_error: Option<f64>,
    /// Text that the page shows for it.
    pub tip: String,
}

const ROW: f64 = 24.0;
const INDENT: f64 = 22.0;
const WIDTH: f64 = 1000.0;
/// Begin and end of the bars with delays.
const BARS: (f64, f64) = (690.0, 985.0);

/// Draws the tree.
pub fn draw(title: &str, nodes: &[Node]) -> Picture {
    let depths = depths(nodes);
    let deepest = depths.iter().copied().max().unwrap_or(0) as f64;
    // A long line of SubDevices becomes a slope that stays in its half of the drawing.
    let indent = if deepest * INDENT > 330.0 { 330.0 / deepest } else { INDENT };
    let place = |at: usize| (26.0 + (depths[at] + 1) as f64 * indent, 20.0 + (at + 1) as f64 * ROW);
    let (most, least) = nodes
        .iter()
        .filter_map(|node| node.delay)
        .fold((1.0f64, 0.0f64), |m, d| (m.0.max(d), m.1.min(d)));
    let x = |delay: f64| BARS.0 + (delay - least) / (most - least) * (BARS.1 - BARS.0);
    let mut body = format!(
        "<text class=\"quiet\" x=\"{}\" y=\"14\">propagation delay from the reference clock, 0x0928</text>\n\
         <text class=\"name\" x=\"40\" y=\"24\">MainDevice</text><rect class=\"node\" x=\"20\" y=\"14\" width=\"12\" height=\"12\"/>\n",
        BARS.0
    );
    for (at, node) in nodes.iter().enumerate() {
        let (cx, cy) = place(at);
        let (px, py) = node.parent.map_or((26.0, 20.0), |parent| place(parent.min(at)));
        let _ = writeln!(
            body,
            "<path class=\"edge\" d=\"M{} {}V{}H{}\"/>",
            number(px),
            number(py + 6.0),
            number(cy),
            number(cx - 6.0)
        );
    }
    for (at, node) in nodes.iter().enumerate() {
        let (cx, cy) = place(at);
        let mut class = "node".to_owned();
        if node.leads {
            class += " lead";
        }
        if node.bad {
            class += " bad";
        }
        let port = node.port.map_or(String::new(), |port| format!("  port {port}"));
        let lead = if node.leads { "  reference clock" } else { "" };
        let _ = writeln!(
            body,
            "<g class=\"mark\" data-device=\"{at}\"><circle class=\"{class}\" cx=\"{}\" cy=\"{}\" r=\"5.5\"/>\
             <text x=\"{}\" y=\"{}\"{}>{at}  {}<tspan class=\"quiet\" fill-opacity=\".75\">{port}{lead}</tspan></text>\
             <title>{}</title></g>",
            number(cx),
            number(cy),
            number(cx + 11.0),
            number(cy + 4.0),
            if node.bad { " class=\"bad\"" } else { "" },
            escape(&node.name),
            escape(&node.tip)
        );
        let Some(delay) = node.delay else { continue };
        let (from, to) = (x(0.0), x(delay));
        let words = match node.delay_error {
            Some(error) => format!("{delay} ±{error} ns"),
            None => format!("{delay} ns"),
        };
        // Words are placed where they fit.
        let (at_x, anchor) =
            if to > 860.0 { (to - 5.0, "end") } else { (to.max(from) + 6.0, "start") };
        let _ = writeln!(
            body,
            "<rect class=\"wire band\" x=\"{}\" y=\"{}\" width=\"{}\" height=\"14\"><title>{}</title></rect>\
             <text class=\"quiet\" x=\"{}\" y=\"{}\" text-anchor=\"{anchor}\">{}</text>",
            number(from.min(to)),
            number(cy - 7.0),
            number((to - from).abs().max(1.0)),
            escape(&node.tip),
            number(at_x),
            number(cy + 4.0),
            escape(&words)
        );
    }
    Picture {
        width: WIDTH as u32,
        height: (34.0 + (nodes.len() + 1) as f64 * ROW) as u32,
        title: title.to_owned(),
        attributes: String::new(),
        body,
    }
}

/// Depth of each node; the one that continues its branch stays in its column.
fn depths(nodes: &[Node]) -> Vec<usize> {
    let mut depths: Vec<usize> = Vec::with_capacity(nodes.len());
    for (at, node) in nodes.iter().enumerate() {
        let depth = match node.parent.filter(|parent| *parent < at) {
            Some(parent) => depths[parent] + 1,
            None => 0,
        };
        depths.push(depth);
    }
    depths
}
