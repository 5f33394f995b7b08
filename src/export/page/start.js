"use strict";
// Plays the GLB that stands in this page: a skin of rigid joints whose matrices are all that changes from frame to frame, and where it has any,
// weights of morph targets.

const by = (id) => document.getElementById(id);
const run = JSON.parse(by("run").textContent);

