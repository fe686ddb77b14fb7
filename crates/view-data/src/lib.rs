//! Readers of posed-view data sets, and the selection of context and target views.
