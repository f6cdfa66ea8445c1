//! Plans and what is made of them: slack, limits, suggestions, files for other tools.

mod new;
mod op_modes;
mod plan;
mod plan_edges;
mod plan_limits;
mod suggestions;
mod sync_words;
mod tools;
mod what_if;
