//! Round trips on a network interface, for `benches/wire.sh`: a bare echo, and a ping that measures
//! it or a served segment. Linux, needs the capability for raw sockets.
//!
//! ```text
//! wire echo IF [busy]                     sends every EtherCAT frame back
//! wire ping IF CYCLE COUNT LENGTH [busy]  sends COUNT frames of LENGTH bytes, one each CYCLE microseconds
//! wire main IF CYCLE COUNT [busy]         brings the segment behind IF to OP, then sends the frames of its cycle
//! ```
//!
//! The last two print one line: frames a cycle, bytes of the first, round trips until the last is
//! back in microseconds (least, median, 99 %, most), cycles that were not back before the next.

#[cfg(target_os = "linux")]
fn main() {
    if let Err(error) = linux::main() {
        eprintln!("{error}");
        std::process::exit(2);
    }
}

#[cfg(not(target_os = "linux"))]
fn main() {
    eprintln!("raw sockets are Linux's");
    std::process::exit(2);
}

#[cfg(target_os = "linux")]
mod linux {
    use std::error::Error;

    use isocat::Nanos;
    use isocat::host::{RawSocket, clock};
    use isocat_maindevice::{Config, Event, FRAME_LEN, MainDevice};
    use isocat_wire::time::{Host, Time};

    type Result<T> = std::result::Result<T, Box<dyn Error>>;

    const USAGE: &str = "wire echo IF [busy] | ping IF CYCLE_US COUNT LENGTH [busy] | main IF CYCLE_US COUNT [busy]";

    pub fn main() -> Result<()> {
        let all: Vec<String> = std::env::args().skip(1).collect();
        let words: Vec<&str> = all.iter().map(String::as_str).collect();
        let busy = words.last() == Some(&"busy");
        match words.as_slice() {
            ["echo", interface, ..] => echo(RawSocket::open(interface, None)?, busy),
            ["ping", interface, cycle, count, length, ..] => {
                let mut frame = vec![0x5A; length.parse()?];
                frame[..14].copy_from_slice(&[
                    0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0x10, 0x10, 0x10, 0x10, 0x10, 0x10, 0x88,
                    0xA4,
                ]);
                let socket = RawSocket::open(interface, None)?;
                ping(socket, &[frame], Nanos::micros(cycle.parse()?), count.parse()?, busy)
            }
            ["main", interface, cycle, count, ..] => {
                let mut socket = RawSocket::open(interface, None)?;
                let cycle = Nanos::micros(cycle.parse()?);
                let frames = bring_up(&mut socket, cycle)?;
                ping(socket, &frames, cycle, count.parse()?, busy)
            }
            _ => Err(USAGE.into()),
        }
    }

    fn echo(mut socket: RawSocket, busy: bool) -> Result<()> {
        let mut buffer = [0; 2048];
        loop {
            if !busy {
                socket.wait(None)?;
            }
            if let Some(received) = socket.receive(&mut buffer)? {
                // As a first ESC does.
                buffer[6] |= 0x02;
                socket.send(&buffer[..received.len])?;
            }
        }
    }

    /// Brings whatever is there to OP and gives the frames of one cycle.
    fn bring_up(socket: &mut RawSocket, cycle: Nanos) -> Result<Vec<Vec<u8>>> {
        let mut config = Config::new(cycle.max(Nanos::micros(1_000)));
        config.host_jitter = Nanos(config.cycle.0 / 5);
        config.stamp_noise = Nanos::micros(20);
        config.force = true;
        let mut main = MainDevice::new(config, clock::now());
        let (mut buffer, mut frames) = ([0; FRAME_LEN], Vec::new());
        loop {
            let mut cyclic = Vec::new();
            while let Some(len) = main.poll_transmit(clock::now(), &mut buffer) {
                socket.send(&buffer[..len])?;
                // Their indices are from 0x80 on.
                if buffer[17] >= 0x80 {
                    cyclic.push(buffer[..len].to_vec());
                }
            }
            if !cyclic.is_empty() {
                frames = cyclic;
            }
            while let Some(event) = main.poll_event() {
                match event {
                    Event::InOperation { .. } => return Ok(frames),
                    Event::Failed(error) => return Err(error.to_string().into()),
                    _ => {}
                }
            }
            let Some(due) = main.next_timeout() else { return Err("it is over".into()) };
            socket.wait(Some(due))?;
            let mut reply = [0; 2048];
            let mut idle = true;
            while let Some(received) = socket.receive(&mut reply)? {
                main.handle_frame(clock::now(), &reply[..received.len]);
                idle = false;
            }
            if idle {
                main.handle_timeout(clock::now());
            }
        }
    }

    /// Sends the frames of a cycle again and again, numbered in their source address.
    fn ping(
        mut socket: RawSocket,
        frames: &[Vec<u8>],
        cycle: Nanos,
        count: usize,
        busy: bool,
    ) -> Result<()> {
        let mut frames = frames.to_vec();
        let mut trips: Vec<i64> = Vec::with_capacity(count);
        let mut late = 0;
        let mut buffer = [0; 2048];
        let mut due = clock::now() + Nanos::millis(1);
        for number in 0..count {
            until(due, busy);
            // Host stalls are not made up for.
            due = clock::now().max(due);
            let start = clock::now();
            for frame in &mut frames {
                // No ESC touches these.
                frame[8..12].copy_from_slice(&(number as u32).to_be_bytes());
                socket.send(frame)?;
            }
            let next = due + cycle;
            let mut back = 0;
            while back < frames.len() {
                if !busy {
                    socket.wait(Some(next))?;
                }
                match socket.receive(&mut buffer)? {
                    Some(_) if buffer[8..12] == (number as u32).to_be_bytes() => back += 1,
                    Some(_) => {}
                    None if clock::now() >= next => break,
                    None => {}
                }
            }
            if back == frames.len() {
                trips.push((clock::now() - start).0);
            } else {
                late += 1;
            }
            due = next;
        }
        trips.sort_unstable();
        let at = |share: f64| {
            let last = trips.len().saturating_sub(1);
            trips.get((last as f64 * share) as usize).map_or(f64::NAN, |ns| *ns as f64 / 1e3)
        };
        println!(
            "{} {} {:.1} {:.1} {:.1} {:.1} {late}",
            frames.len(),
            frames[0].len(),
            at(0.0),
            at(0.5),
            at(0.99),
            at(1.0)
        );
        Ok(())
    }

    fn until(due: Time<Host>, busy: bool) {
        if busy {
            while clock::now() < due {
                std::hint::spin_loop();
            }
        } else {
            clock::sleep_until(due);
        }
    }
}
