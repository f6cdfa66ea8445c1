//! The application on the cycle: the part that a user of the MainDevice writes.
//!
//! The MainDevice knows when a cycle is complete: every frame of it is back, or the next cycle is
//! due and the missing frames are given up. Then, once for each cycle, [`MainDevice::poll_cycle`]
//! calls [`Application::cycle`] with a [`Cycle`]. It holds the inputs that came back, which of them
//! are of this cycle, and the outputs that leave with the next one. The same application runs on a
//! real interface and in virtual time, since a [`Runner`](crate::Runner) calls it in both.
//!
//! - Frames that are not part of the cycle (requests, readings in the background) do not count.
//! - In a cycle without process data the application is not called. These are the cycles before all
//!   SubDevices go to SAFEOP and after they left it. The first frames of process data carry zeros.
//!   SubDevices use no outputs before OP, and the application has been called at least ten times
//!   before the first of them gets there.
//! - A frame that comes after its cycle was given up is still used: [`Device::inputs_cycle`] is the
//!   cycle of a SubDevice's inputs.

use isocat_sync::phase::external::Stamps;
use isocat_wire::al::{AlState, AlStatus};
use isocat_wire::time::{Dc, Host, Time};
use isocat_wire::{ObjectAddress, StationAddress};

use crate::cycle::Exchanged;
use crate::event::{Event, RequestId};
use crate::machine::MainDevice;
use crate::segment::SubDevice;

/// A user of the process data.
///
/// A closure that takes a [`Cycle`] is an application, and `()` is one that does nothing.
///
/// ```
/// use isocat_maindevice::{Application, Cycle};
///
/// struct Copy;
///
/// impl Application for Copy {
///     fn cycle(&mut self, cycle: &mut Cycle<'_>) {
///         for mut device in cycle.devices() {
///             if device.is_fresh() {
///                 device.copy_inputs_to_outputs();
///             }
///         }
///     }
/// }
/// ```
pub trait Application {
    /// Called once in each cycle with process data, in order. All frames of the cycle are back or
    /// given up, and those of the next cycle have not left. Outputs that are written here leave
    /// with the next cycle.
    ///
    /// It should return before the next cycle is due; otherwise that cycle is late.
    fn cycle(&mut self, cycle: &mut Cycle<'_>);

    /// Called for each event. Answers to requests made with [`Cycle::upload`], [`Cycle::download`]
    /// and [`Cycle::read_memory`] also come here.
    fn event(&mut self, event: &Event) {
        let _ = event;
    }
}

impl Application for () {
    fn cycle(&mut self, _: &mut Cycle<'_>) {}
}

impl<F: FnMut(&mut Cycle<'_>)> Application for F {
    fn cycle(&mut self, cycle: &mut Cycle<'_>) {
        self(cycle);
    }
}

/// The call of the application.
impl MainDevice {
    /// Calls the application if the last input has completed a cycle, and returns the cycle's
    /// number. A cycle is complete if all of its frames are back, or if the next one is due and the
    /// missing ones were given up. Each cycle is returned once, in order; the application is not
    /// called for cycles without process data. Call this after each input, before
    /// [`poll_transmit`](Self::poll_transmit): a complete cycle that was not polled before the next
    /// one is complete is not reported.
    #[inline]
    pub fn poll_cycle<A: Application + ?Sized>(&mut self, application: &mut A) -> Option<u64> {
        let (number, has_data) = self.take_closed()?;
        if has_data {
            application.cycle(&mut Cycle { main: self, number });
        }
        Some(number)
    }
}

/// One complete cycle, as the application sees it.
///
/// - What came back: [`devices`](Self::devices), [`device`](Self::device),
///   [`inputs`](Self::inputs), [`reference_time`](Self::reference_time).
/// - What leaves with the next cycle: [`outputs_mut`](Self::outputs_mut), or
///   [`Device::outputs_mut`].
/// - Requests: [`upload`](Self::upload), [`download`](Self::download),
///   [`read_memory`](Self::read_memory), [`external_stamps`](Self::external_stamps),
///   [`stop`](Self::stop).
/// - All other information: [`main`](Self::main).
pub struct Cycle<'a> {
    main: &'a mut MainDevice,
    number: u64,
}

impl<'a> Cycle<'a> {
    /// Its number, from 1 on. Cycles before process data count too, so the first call has a number
    /// above 1.
    pub fn number(&self) -> u64 {
        self.number
    }

    /// System time at which the first frame of this cycle passed the reference clock. `None` if
    /// that frame is not back or did not reach all clocks, or if there is no reference clock.
    pub fn reference_time(&self) -> Option<Time<Dc>> {
        self.main.exchange()?.reference_time_of(self.number)
    }

    /// When the next cycle is due.
    pub fn next(&self) -> Option<Time<Host>> {
        self.main.next_cycle()
    }

    /// See [`MainDevice::next_grid`]. It measures the progress of a motion better than a count of
    /// the calls, since a host that slept skips cycles.
    pub fn next_grid(&self) -> Option<Time<Dc>> {
        self.main.next_grid()
    }

    /// Number of SubDevices, present or not.
    pub fn len(&self) -> usize {
        self.main.segment().devices.len()
    }

    /// Whether there are no SubDevices.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// All SubDevices, in the order of the process image: by position, with groups of a longer
    /// cycle after the others.
    pub fn devices(&mut self) -> Devices<'_> {
        let number = self.number;
        let (segment, exchange) = self.main.parts_mut();
        let (outputs, exchanged, order) = match exchange {
            Some(exchange) => {
                let (outputs, exchanged) = exchange.exchanged();
                (outputs, Some(exchanged), exchanged.order())
            }
            None => Default::default(),
        };
        let order = order.iter();
        Devices { number, devices: &segment.devices, exchanged, outputs, before: 0, order }
    }

    /// The SubDevice at a position.
    pub fn device(&mut self, position: usize) -> Option<Device<'_>> {
        let number = self.number;
        let (segment, exchange) = self.main.parts_mut();
        let (outputs, exchanged) = exchange?.exchanged();
        let found = segment.devices.get(position)?;
        let outputs = outputs.get_mut(found.outputs.range()).unwrap_or_default();
        Some(Device { number, found, exchanged, outputs })
    }

    /// The inputs of the SubDevice at a position as they last came back; empty without inputs.
    pub fn inputs(&self, position: usize) -> &[u8] {
        self.main.inputs(position)
    }

    /// The outputs of the SubDevice at a position; empty without outputs.
    pub fn outputs_mut(&mut self, position: usize) -> &mut [u8] {
        self.main.outputs_mut(position)
    }

    /// The outputs of all SubDevices, as they are in the process image.
    pub(crate) fn image_mut(&mut self) -> &mut [u8] {
        self.main.parts_mut().1.map_or(&mut [], |exchange| exchange.outputs_mut())
    }

    /// The MainDevice, read only.
    pub fn main(&self) -> &MainDevice {
        self.main
    }

    /// See [`MainDevice::upload`]; the answer comes to [`Application::event`].
    pub fn upload(&mut self, position: usize, object: ObjectAddress) -> RequestId {
        self.main.upload(position, object)
    }

    /// See [`MainDevice::download`]; the answer comes to [`Application::event`].
    pub fn download(&mut self, position: usize, object: ObjectAddress, data: &[u8]) -> RequestId {
        self.main.download(position, object, data)
    }

    /// See [`MainDevice::read_memory`]; the answer comes to [`Application::event`].
    pub fn read_memory(&mut self, position: usize, address: u16, len: usize) -> RequestId {
        self.main.read_memory(position, address, len)
    }

    /// See [`MainDevice::external_stamps`].
    pub fn external_stamps(&mut self, stamps: Stamps) {
        self.main.external_stamps(stamps);
    }

    /// See [`MainDevice::stop`]. The application is still called until process data end.
    pub fn stop(&mut self) {
        self.main.stop();
    }
}

/// The SubDevices of a cycle, see [`Cycle::devices`].
pub struct Devices<'a> {
    number: u64,
    devices: &'a [SubDevice],
    exchanged: Option<Exchanged<'a>>,
    /// The outputs that the iterator has not given out yet. `before` is the length of those given
    /// out.
    outputs: &'a mut [u8],
    before: usize,
    order: core::slice::Iter<'a, usize>,
}

impl<'a> Iterator for Devices<'a> {
    type Item = Device<'a>;

    fn next(&mut self) -> Option<Device<'a>> {
        let exchanged = self.exchanged?;
        let found = self.devices.get(*self.order.next()?)?;
        let range = found.outputs.range();
        let mut outputs: &'a mut [u8] = &mut [];
        if !range.is_empty() && range.start >= self.before {
            let skipped = range.start - self.before;
            let rest = core::mem::take(&mut self.outputs);
            if let Some((own, rest)) =
                rest.get_mut(skipped..).and_then(|rest| rest.split_at_mut_checked(range.len()))
            {
                (outputs, self.outputs, self.before) = (own, rest, range.end);
            }
        }
        Some(Device { number: self.number, found, exchanged, outputs })
    }
}

/// One SubDevice in a cycle.
pub struct Device<'a> {
    number: u64,
    found: &'a SubDevice,
    exchanged: Exchanged<'a>,
    outputs: &'a mut [u8],
}

impl Device<'_> {
    /// Position in processing order.
    pub fn position(&self) -> usize {
        self.found.position
    }

    /// Configured station address.
    pub fn station(&self) -> StationAddress {
        self.found.station
    }

    /// All that is known of the SubDevice: name, mapping, times, states.
    pub fn subdevice(&self) -> &SubDevice {
        self.found
    }

    /// Its inputs as they last came back; empty without inputs. All of them were latched at one
    /// time, since the inputs of a SubDevice are never divided among frames.
    pub fn inputs(&self) -> &[u8] {
        self.exchanged.inputs(self.found)
    }

    /// The outputs that leave with the next cycle in which its group takes part; empty without
    /// outputs. They keep what was last written.
    pub fn outputs_mut(&mut self) -> &mut [u8] {
        self.outputs
    }

    /// Copies inputs to outputs, up to the shorter length.
    pub fn copy_inputs_to_outputs(&mut self) {
        let inputs = self.exchanged.inputs(self.found);
        let len = inputs.len().min(self.outputs.len());
        self.outputs[..len].copy_from_slice(&inputs[..len]);
    }

    /// Whether its inputs are of this cycle. False if its group does not take part in this cycle,
    /// if its frame was lost or is late, if its datagram's working counter was wrong, if it is
    /// absent, and if it has no inputs.
    pub fn is_fresh(&self) -> bool {
        self.inputs_cycle() == Some(self.number)
    }

    /// The number of the cycle of its inputs; `None` if no inputs came back yet, or it has none.
    pub fn inputs_cycle(&self) -> Option<u64> {
        self.exchanged.inputs_cycle(self.found.position)
    }

    /// Whether frames of its group left in this cycle. Always true for a mapped SubDevice in the
    /// bus cycle.
    pub fn takes_part(&self) -> bool {
        self.exchanged.takes_part(self.found.position)
    }

    /// Whether it is present and takes part in the exchange. False for a SubDevice that is lost or
    /// has not come yet.
    pub fn is_admitted(&self) -> bool {
        self.found.admitted
    }

    /// Whether it was in OP when its state was last read. In operation, a SubDevice that leaves OP
    /// is noticed some cycles later; during bring-up this becomes true when all SubDevices are in
    /// OP.
    pub fn is_in_operation(&self) -> bool {
        self.found.admitted && self.found.al_status == AlStatus::new(AlState::Op)
    }
}
