//! Effects of late outputs on the machines behind devices.

use isocat_engine::report::plant::{Plants, Size};
use isocat_wire::time::Nanos;
use maud::{Markup, html};

/// A table of all machines; empty if there are none.
pub fn section(plants: Option<&Plants>) -> Markup {
    let Some(plants) = plants else { return html! {} };
    html! {
        section #machines {
            h2 { "What late outputs did to the machines" }
            table {
                thead { tr {
                    th { "device" } th { "command" } th { "deviation, um" } th { "rms" } th { "following, um" } th { "on the grid" }
                    th { "coupling, Nm" } th { "on the grid" } th { "ripple, Nm" } th { "rms" }
                } }
                tbody {
                    @for plant in &plants.each {
                        tr {
                            td { (plant.device) }
                            td { (plant.commands) }
                            (cells(plant.deviation_um))
                            (largest(plant.following_um)) (largest(plant.ideal_following_um))
                            (largest(plant.coupling_nm)) (largest(plant.ideal_coupling_nm))
                            (cells(plant.ripple_nm))
                        }
                    }
                }
            }
            p {
                "Deviation is from where the load would be if the same commands had acted on the grid. "
                @if let (Some(apart), Some(at)) = (plants.apart_um, plants.apart_at_ns) {
                    "The deviations of axes were at most " (apart.largest) " um apart, " (Nanos(at / 1_000 * 1_000)) " into the run."
                }
            }
        }
    }
}

fn largest(size: Option<Size>) -> Markup {
    html! { td { @if let Some(size) = size { (size.largest) } @else { "-" } } }
}

fn cells(size: Option<Size>) -> Markup {
    html! { (largest(size)) td { @if let Some(size) = size { (size.rms) } } }
}
