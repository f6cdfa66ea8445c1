//! How the counter of missed SM events, 0x1C32:0B, goes up.

use isocat::picture::{Align, Frame, Picture, time};
use isocat_sim::observation::Observed;
use isocat_wire::time::Picos;

use crate::run::Ran;

const HEIGHT: f64 = 44.0;
/// Misses that are drawn for a device.
const MOST: usize = 400;

/// Draws the counter of each device at each miss, up to `until`; `None` if nobody missed anything.
pub fn draw(ran: &Ran, until: Picos) -> Option<Picture> {
    let misses = |position: usize| {
        let of = ran.events.iter().filter(move |(_, device, _)| *device == position);
        of.filter_map(|(at, _, event)| match event {
            Observed::SmEventMissed(counter) => Some((*at, *counter)),
            _ => None,
        })
    };
    let all: Vec<usize> =
        (0..ran.report.devices.len()).filter(|at| misses(*at).next().is_some()).collect();
    let ends = all.iter().filter_map(|position| misses(*position).last());
    let end = ends.map(|(at, _)| at).max()?.max(ran.recorded.length);
    let title = "Counter 0x1C32:0B, SM event missed";
    let mut frame = Frame::new("counter", title, 0.0, end.0 as f64 / 1e3);
    for position in all {
        let most = misses(position).map(|(_, counter)| counter).max().unwrap_or(1).max(1);
        let name = &ran.report.devices[position].name;
        let top = frame.lane(name, HEIGHT + 16.0) + 14.0;
        let mut last = None;
        for (at, counter) in misses(position).take(MOST).take_while(|(at, _)| *at < until) {
            let height = f64::from(counter) / f64::from(most) * HEIGHT;
            let ns = at.0 as f64 / 1e3;
            let tip = format!("{name}: 0x1C32:0B = {counter} at {}", time(ns));
            frame.mark("m late", ns, top + HEIGHT - height, height, &tip);
            last = Some((ns, counter));
        }
        if let Some((ns, counter)) = last {
            frame.label("bad", ns, top - 2.0, Align::End, &format!("0x1C32:0B = {counter}"));
        }
    }
    let until = until.0 as f64 / 1e3;
    if until < end.0 as f64 / 1e3 {
        let top = frame.lane("", 16.0);
        frame.mark("m wire", until, top, 12.0, &format!("looked at: {}", time(until)));
    }
    Some(frame.finish())
}
