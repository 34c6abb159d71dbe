// Copyright 2026 starcal_ros contributors
// SPDX-License-Identifier: Apache-2.0
'use strict';
// Where a finger both scrolls and zooms, zooming is left to the buttons.
const touch = window.matchMedia('(pointer: coarse)').matches;
const dark = window.matchMedia('(prefers-color-scheme: dark)');
const charts = Array.from(document.querySelectorAll('.chart'));
const config = {
  responsive: true, displaylogo: false, displayModeBar: touch ? true : 'hover',
  // Named one by one: among plotly's own choice is one that uploads the chart.
  modeBarButtons: [['toImage'], ['zoom2d', 'pan2d'], ['zoomIn2d', 'zoomOut2d', 'resetScale2d']],
};
// The colours of the data are those of paper; report.css has those of a dark screen.
function painted(text, onPaper) {
  if (onPaper || !dark.matches) return text;
  const style = getComputedStyle(document.documentElement);
  for (const [colour, role] of Object.entries(roles)) {
    text = text.replaceAll(colour, style.getPropertyValue(role).trim());
  }
  return text;
}
// plotly makes three pictures of a chart and one of each button; none says what it is.
function label(chart) {
  const name = chart.parentElement.querySelector('figcaption').textContent;
  chart.querySelectorAll('svg').forEach((svg) => svg.setAttribute('aria-hidden', 'true'));
  const first = chart.querySelector('.main-svg');
  first.removeAttribute('aria-hidden');
  first.setAttribute('role', 'img');
  first.setAttribute('aria-label', name);
  for (const button of chart.querySelectorAll('.modebar-btn')) {
    button.setAttribute('role', 'button');
    button.setAttribute('aria-label', `${button.dataset.title}: ${name}`);
  }
}
function draw(chart, onPaper) {
  const text = painted(chart.nextElementSibling.textContent, onPaper);
  const { data, layout } = JSON.parse(text);
  if (touch) layout.dragmode = false;
  // A page of paper has another width than the window.
  if (onPaper) layout.width = chart.closest('.wide') ? 690 : 225;
  if (onPaper) layout.height = Math.min(layout.height, chart.closest('.wide') ? 250 : 205);
  if (onPaper) layout.font.size = 8;
  chart.style.height = `${layout.height}px`;
  Plotly.react(chart, data, layout, config);
  label(chart);
}
charts.forEach((chart) => draw(chart, false));
// plotly measures texts in a picture of its own, outside of the page.
document.getElementById('js-plotly-tester')?.setAttribute('aria-hidden', 'true');
dark.addEventListener('change', () => charts.forEach((chart) => draw(chart, false)));
window.addEventListener('beforeprint', () => {
  for (const details of document.querySelectorAll('details')) details.open = true;
  charts.forEach((chart) => draw(chart, true));
});
window.addEventListener('afterprint', () => charts.forEach((chart) => draw(chart, false)));
