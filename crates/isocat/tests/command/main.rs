//! The command as a user meets it, its documentation, and the rules of the house.

mod calibrate;
mod command;
mod documents;
mod eni_interface;
mod explain;
mod facts;
mod findings;
mod first_screen;
mod interface;
mod invariants;
mod limits;
mod machine_in_ci;
mod outputs;
mod scan;
mod serve;
mod shown;
mod supervised;
mod supported;
mod test_table;
mod virtual_time;
mod virtual_time_unruly;
