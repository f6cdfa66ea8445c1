//! ethercrab as it comes from the registry, issuing exactly what a start-up list says and nothing
//! else.
//!
//! `start_up INTERFACE LIST.json CYCLES`, with the list of `isocat plan --start-up --json`.
//! ethercrab carries the datagrams; it neither scans nor configures anything itself. Goes through
//! the transitions of the list up to OP, exchanges the frames of the list for so many cycles and
//! looks that every working counter and the state of all SubDevices is right. Exit code 0: it is.

use std::cell::Cell;
use std::time::{Duration, Instant};

use ethercrab::std::tx_rx_task;
use ethercrab::{
    Command, MainDevice, MainDeviceConfig, PduStorage, Timeouts, WrappedRead, WrappedWrite,
};
use serde_json::Value;

static STORAGE: PduStorage<16, { PduStorage::element_size(1472) }> = PduStorage::new();

type Outcome<T = ()> = Result<T, Box<dyn std::error::Error>>;

fn main() {
    let mut arguments = std::env::args().skip(1);
    let (Some(interface), Some(list), Some(cycles)) =
        (arguments.next(), arguments.next(), arguments.next())
    else {
        eprintln!("usage: start_up INTERFACE LIST.json CYCLES");
        std::process::exit(2);
    };
    let list = std::fs::read_to_string(list).expect("the list is readable");
    let list: Value = serde_json::from_str(&list).expect("the list is JSON");
    let cycles = cycles.parse().expect("a number of cycles");
    let (tx, rx, pdu_loop) = STORAGE.try_split().expect("split once");
    let wire = tx_rx_task(&interface, tx, rx).expect("a raw socket on the interface");
    std::thread::spawn(move || async_io::block_on(wire).map(drop));
    let timeouts = Timeouts { pdu: Duration::from_millis(200), ..Timeouts::default() };
    let wire = MainDevice::new(pdu_loop, timeouts, MainDeviceConfig::default());
    if let Err(error) =
        async_io::block_on(Executor { wire: &wire, list: &list, counter: Cell::new(0) }.run(cycles))
    {
        eprintln!("failed: {error}");
        std::process::exit(1);
    }
    std::process::exit(0);
}

struct Executor<'a> {
    wire: &'a MainDevice<'a>,
    list: &'a Value,
    /// Of mailbox messages, 1 to 7: one that comes twice is a repetition.
    counter: Cell<u8>,
}

impl Executor<'_> {
    async fn run(&self, cycles: u32) -> Outcome {
        for step in array(&self.list["before"]) {
            self.register(step).await?;
        }
        let devices = array(&self.list["devices"]);
        for transition in ["IP", "PS", "SO"] {
            for device in devices {
                let of = |key: &str| -> Vec<&Value> {
                    let steps = array(&device[key]).iter();
                    steps
                        .filter(|step| array(&step["transitions"]).iter().any(|t| t == transition))
                        .collect()
                };
                // The order of the list: objects first, unless the transition begins without a
                // mailbox.
                let (registers, objects) = (of("registers"), of("objects"));
                if transition != "IP" {
                    for object in &objects {
                        self.object(device, object).await?;
                    }
                }
                for step in registers {
                    self.register(step)
                        .await
                        .map_err(|error| format!("{}: {error}", device["name"]))?;
                }
                if transition == "IP" {
                    for object in &objects {
                        self.object(device, object).await?;
                    }
                }
            }
            println!("{transition} done by {} SubDevices", devices.len());
        }
        let cycle = Duration::from_nanos(self.list["cycle_ns"].as_u64().ok_or("no cycle")?);
        let mut due = Instant::now();
        for _ in 0..cycles {
            self.frames("OP").await?;
            due += cycle;
            async_io::Timer::at(due).await;
        }
        println!("OP held for {cycles} cycles");
        Ok(())
    }

    /// One access, checked as the list says; process data goes on while a state is waited for.
    async fn register(&self, step: &Value) -> Outcome {
        let data = bytes(&step["data"])?;
        let patience = step["check"]["patience_ms"].as_u64().unwrap_or(0);
        let end = Instant::now() + Duration::from_millis(patience);
        loop {
            let back = self.datagram(step, &data, step["working_counter"].as_u64()).await;
            let (check, mask) = (&step["check"]["data"], &step["check"]["mask"]);
            let right = match &back {
                Err(_) => false,
                Ok(_) if !check.is_string() => true,
                Ok(back) => {
                    let (check, mask) = (bytes(check)?, bytes(mask)?);
                    back.iter()
                        .zip(&check)
                        .zip(&mask)
                        .all(|((back, check), mask)| back & mask == *check)
                }
            };
            if right {
                return Ok(());
            }
            if Instant::now() > end {
                return Err(format!("{}: {back:02x?}", step["comment"]).into());
            }
            // OP is only given to who exchanges process data.
            if array(&step["transitions"]).iter().any(|transition| transition == "SO") {
                self.frames("SAFEOP").await?;
            }
            async_io::Timer::after(Duration::from_millis(1)).await;
        }
    }

    /// The frames of a cycle, as far as they belong to a state. In OP the AL status of all must be
    /// OP.
    async fn frames(&self, state: &str) -> Outcome {
        for datagram in
            array(&self.list["frames"]).iter().flat_map(|frame| array(&frame["datagrams"]))
        {
            if !array(&datagram["states"]).iter().any(|other| other == state) {
                continue;
            }
            let length = datagram["length"].as_u64().ok_or("no length")? as usize;
            let expected = datagram["working_counter"].as_u64().filter(|_| state == "OP");
            let back = self.datagram(datagram, &vec![0; length], expected).await;
            let back = back.map_err(|error| format!("{}: {error}", datagram["comment"]))?;
            if state == "OP" && datagram["command"] == "BRD" && back.first() != Some(&8) {
                return Err(format!("AL status of all: {back:02x?}, not OP").into());
            }
        }
        Ok(())
    }

    /// Sends a datagram; a working counter that is not as expected is an error.
    async fn datagram(&self, step: &Value, data: &[u8], counter: Option<u64>) -> Outcome<Vec<u8>> {
        let name = step["command"].as_str().ok_or("no command")?;
        let physical = &step["address"]["physical"];
        let logical = || number(&step["address"]["logical"]);
        let place = || {
            Ok::<_, Box<dyn std::error::Error>>((
                number(&physical["device"])? as u16,
                number(&physical["register"])? as u16,
            ))
        };
        let wire = self.wire;
        let length = data.len() as u16;
        let write = |command: WrappedWrite| match counter {
            Some(counter) => command.with_wkc(counter as u16),
            None => command.ignore_wkc(),
        };
        let read = |command: WrappedRead| match counter {
            Some(counter) => command.with_wkc(counter as u16),
            None => command.ignore_wkc(),
        };
        let back = match name {
            "BWR" => write(Command::bwr(place()?.1)).send_receive_slice(wire, data).await?,
            "APWR" => {
                // The list has what is sent, ethercrab wants the position.
                let (device, register) = place()?;
                write(Command::apwr(device.wrapping_neg(), register))
                    .send_receive_slice(wire, data)
                    .await?
            }
            "FPWR" => {
                let (device, register) = place()?;
                write(Command::fpwr(device, register)).send_receive_slice(wire, data).await?
            }
            "FPRD" => {
                let (device, register) = place()?;
                read(Command::fprd(device, register)).receive_slice(wire, length).await?
            }
            "BRD" => read(Command::brd(place()?.1)).receive_slice(wire, length).await?,
            "FRMW" => {
                let (device, register) = place()?;
                read(Command::frmw(device, register)).receive_slice(wire, length).await?
            }
            "LRW" => write(Command::lrw(logical()? as u32)).send_receive_slice(wire, data).await?,
            other => return Err(format!("{other} is not tried here").into()),
        };
        Ok(back.to_vec())
    }

    /// An SDO download of at most four bytes, through the mailbox by hand.
    async fn object(&self, device: &Value, step: &Value) -> Outcome {
        let place = format!("{} {}", device["name"], step["object"]);
        let station = number(&device["station"])? as u16;
        let area = |key: &str| -> Outcome<(u16, u16)> {
            let area = &device["mailbox"][key];
            Ok((number(&area["start"])? as u16, number(&area["length"])? as u16))
        };
        let ((out, out_length), (back, back_length)) = (area("out")?, area("back")?);
        let data = bytes(&step["data"])?;
        let (index, sub) =
            step["object"].as_str().and_then(|text| text.split_once(':')).ok_or("no object")?;
        let index = u16::from_str_radix(index.trim_start_matches("0x"), 16)?;
        let sub = u8::from_str_radix(sub, 16)?;
        if data.is_empty() || data.len() > 4 {
            return Err(format!("{place}: {} bytes are not tried here", data.len()).into());
        }
        self.counter.set(self.counter.get() % 7 + 1);
        let kind = self.counter.get() << 4 | 3;
        let size = 0x23 | (4 - data.len() as u8) << 2;
        let mut message = vec![10, 0, 0, 0, 0, kind, 0, 0x20, size];
        message.extend(index.to_le_bytes());
        message.push(sub);
        message.extend(&data);
        message.resize(usize::from(out_length), 0);
        let sent = Command::fpwr(station, out).send_receive_slice(self.wire, &message[..]).await;
        sent.map_err(|error| format!("{place}: the mailbox does not take it: {error}"))?;
        let end = Instant::now() + Duration::from_secs(2);
        loop {
            let status = Command::fprd(station, 0x080D).receive_slice(self.wire, 1).await?;
            if status.first().is_some_and(|status| status & 8 != 0) {
                break;
            }
            if Instant::now() > end {
                return Err(format!("{place}: no answer").into());
            }
            async_io::Timer::after(Duration::from_millis(1)).await;
        }
        let answer = Command::fprd(station, back).receive_slice(self.wire, back_length).await?;
        match answer.get(8) {
            Some(0x60) => Ok(()),
            _ => Err(format!("{place}: {:02x?}", &answer[..16.min(answer.len())]).into()),
        }
    }
}

fn array(value: &Value) -> &[Value] {
    value.as_array().map_or(&[], Vec::as_slice)
}

/// `"0x1001"`, or a number.
fn number(value: &Value) -> Outcome<u64> {
    match value.as_str() {
        Some(text) => Ok(u64::from_str_radix(text.trim_start_matches("0x"), 16)?),
        None => value.as_u64().ok_or_else(|| format!("{value} is no number").into()),
    }
}

fn bytes(value: &Value) -> Outcome<Vec<u8>> {
    let text = value.as_str().ok_or("no data")?;
    let pairs = (0..text.len()).step_by(2).map(|at| text.get(at..at + 2).unwrap_or("?"));
    Ok(pairs.map(|pair| u8::from_str_radix(pair, 16)).collect::<Result<_, _>>()?)
}
