//! Ray-traced posed views with exact depth from scene descriptions.
