//! Draws how the counter of missed SM events, 0x1C32:0B, changes.

use isocat::picture::{Align, Frame, Picture};
use isocat::quantity::time;
use isocat_wire::time::Picos;

use crate::run::Ran;

const HEIGHT: f64 = 44.0;

/// Draws the counter of each device that counted, with its value at `until`; `None`: no device
/// counted.
pub fn draw(ran: &Ran, until: Picos) -> Option<Picture> {
    let most = |position: usize| ran.counters.iter().map(|(_, all)| all[position]).max();
    let devices = 0..ran.report.devices.len();
    let counted: Vec<(usize, f64)> = devices
        .filter_map(|position| Some((position, f64::from(most(position)?))))
        .filter(|(_, most)| *most > 0.0)
        .collect();
    let length = ran.counters.last()?.0.max(ran.recorded.length).0 as f64 / 1e3;
    let shown = (until.0 as f64 / 1e3).clamp(0.0, length);
    if counted.is_empty() {
        return None;
    }
    let title = "Counter 0x1C32:0B, SM event missed";
    let mut frame = Frame::new("counter", title, 0.0, length);
    for (position, most) in counted {
        let name = &ran.report.devices[position].name;
        let top = frame.lane(name, HEIGHT + 18.0) + 14.0;
        let y = |counter: u16| top + HEIGHT * (1.0 - f64::from(counter) / most);
        let (mut last, mut now) = (0, 0);
        let mut curve = vec![(0.0, y(0))];
        for (at, all) in &ran.counters {
            let (ns, counter) = (at.0 as f64 / 1e3, all[position]);
            curve.extend([(ns, y(last)), (ns, y(counter))]);
            if counter > last {
                let tip = format!("{name}: 0x1C32:0B from {last} to {counter} at {}", time(ns));
                frame.mark("m late", ns, y(counter), top + HEIGHT - y(counter), &tip);
            }
            last = counter;
            if *at < until {
                now = counter;
            }
        }
        curve.push((length, y(last)));
        frame.line("signal", &curve, false);
        let class = if now > 0 { "bad" } else { "quiet" };
        let words = format!("0x1C32:0B = {now}");
        frame.label(class, shown, top - 2.0, Align::End, &words);
    }
    if shown < length {
        let top = frame.lane("", 14.0);
        frame.mark("m wire", shown, top, 10.0, &format!("looked at: {}", time(shown)));
    }
    Some(frame.finish())
}
