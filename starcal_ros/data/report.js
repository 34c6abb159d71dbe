// Copyright 2026 starcal_ros contributors
// SPDX-License-Identifier: Apache-2.0
'use strict';
// Where a finger both scrolls and zooms, zooming is left to the buttons.
const touch = window.matchMedia('(pointer: coarse)').matches;
const charts = Array.from(document.querySelectorAll('.chart'));
for (const chart of charts) {
  const { data, layout } = JSON.parse(chart.nextElementSibling.textContent);
  if (touch) layout.dragmode = false;
  Plotly.newPlot(chart, data, layout, {
    responsive: true, displaylogo: false, displayModeBar: touch ? true : 'hover',
    // Named one by one: among plotly's own choice is one that uploads the chart.
    modeBarButtons: [['toImage'], ['zoom2d', 'pan2d'], ['zoomIn2d', 'zoomOut2d', 'resetScale2d']],
  });
}
// A page of paper has another width than the window; charts have to be drawn anew for it.
window.addEventListener('beforeprint', () => {
  for (const details of document.querySelectorAll('details')) details.open = true;
  for (const chart of charts) {
    Plotly.relayout(chart, { width: chart.closest('.wide') ? 690 : 340 });
  }
});
window.addEventListener('afterprint', () => {
  for (const chart of charts) Plotly.relayout(chart, { width: null, autosize: true });
});
