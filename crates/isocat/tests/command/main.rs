//! The command as a user meets it, its documentation, and the rules of the house.

mod command;
mod documents;
mod explain;
mod findings;
mod first_screen;
mod invariants;
mod limits;
mod machine_in_ci;
mod outputs;
mod scan;
mod virtual_time;
mod virtual_time_unruly;
