//! Carries out the commands of a view.

use crate::gpu::context::{Gpu, Recording};
use crate::gpu::forward::Buffers;
use crate::gpu::upload::Upload;
use gs_shaders::{Action, Argument, Counts, Groups, View, Word, folded};

impl Gpu {
    /// Records every command of a view.
    pub(in crate::gpu) fn carry_out(
        &mut self,
        recording: &mut Recording,
        view: &View,
        counts: &Counts,
        upload: &Upload,
        buffers: &mut Buffers,
    ) {
        let commands = || view.commands.iter().filter(|command| command.applies(counts.tiles));
        // The words of all dispatches in one buffer, which is written once.
        let mut words: Vec<[u32; 4]> =
            commands().filter_map(|command| words(&command.action, counts)).collect();
        words.sort_unstable();
        words.dedup();
        let written = self.pool.uniform_rows(&words);
        for command in commands() {
            match &command.action {
                Action::Clear(name) => recording.encoder().clear_buffer(buffers.get(name), 0, None),
                Action::Swap(a, b) => buffers.swap(a, b),
                Action::Dispatch { pass, entry_point, arguments, groups } => {
                    let bound: Vec<_> = arguments
                        .iter()
                        .map(|argument| match argument.as_ref()? {
                            Argument::Words(argument_words) => {
                                let row = words
                                    .binary_search(&words_of(argument_words, counts))
                                    .expect("all words");
                                Some(written.row(row))
                            }
                            Argument::Buffer("geometry") => Some(upload.geometry.whole()),
                            Argument::Buffer("sh") => Some(upload.sh.whole()),
                            Argument::Buffer(name) => Some(buffers.get(name).whole()),
                        })
                        .collect();
                    let groups = match groups {
                        Groups::Folded(n) => folded(word(n.value(counts))),
                        Groups::Tiles => buffers.frame.tiles,
                    };
                    self.dispatch(recording, pass, entry_point, view.features, groups, &bound);
                }
            }
        }
        recording.keep.push(written.buffer);
    }
}

/// The words of a dispatch, if it has any.
fn words(action: &Action, counts: &Counts) -> Option<[u32; 4]> {
    let Action::Dispatch { arguments, .. } = action else { return None };
    arguments.iter().flatten().find_map(|argument| match argument {
        Argument::Words(words) => Some(words_of(words, counts)),
        Argument::Buffer(_) => None,
    })
}

fn words_of(words: &[Word; 4], counts: &Counts) -> [u32; 4] {
    words.each_ref().map(|one| match one {
        Word::Is(value) => *value,
        Word::Amount(amount) => word(amount.value(counts)),
    })
}

fn word(value: u64) -> u32 {
    u32::try_from(value).expect("amounts of a view that fits the device fit a word")
}
