// Copyright 2026 starcal_ros contributors
// SPDX-License-Identifier: Apache-2.0
'use strict';

// Draws one moment of a calibration: what it says is made by starcal_ros/live/picture.py. All
// that comes in is set as text, never as markup.

const SVG = 'http://www.w3.org/2000/svg';
const HOW = ['usual', 'larger', 'odd'];
const AXES = { X: [-40, 26], Y: [44, 16], Z: [0, -46] };    // of the gyro, all towards the viewer
const SCALE = 0.08;             // of the width: the length of the scale of the residuals

const byId = (id) => document.getElementById(id);

function element(tag, attributes, ...inside) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.append(...inside);
  return made;
}

function shape(tag, attributes, text) {
  const made = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  if (text !== undefined) made.textContent = text;
  return made;
}

function mark(kind, from, to) {         // a piece of a track, in parts of its width
  const made = element('i', { class: kind });
  made.style.left = `${100 * from}%`;
  if (to !== undefined) made.style.width = `${100 * Math.max(to - from, 0)}%`;
  return made;
}

// Verdict, advice

function drawVerdict(moment) {
  const { word, text, kind } = moment.verdict;
  byId('verdict').className = kind;
  byId('word').textContent = word;
  byId('text').textContent = text;
  byId('alike').textContent = moment.not_told_apart && `Not told apart: ${moment.not_told_apart}`;
  byId('turn').textContent = moment.axis ? `rotate about ${moment.axis}`
    : moment.advice.split(';')[0] || '–';
  byId('togo').textContent = moment.time_to_go || '–';
  byId('reprojection').textContent = moment.reprojection || '–';
  byId('stamp').textContent = moment.stamp && `last frame ${moment.stamp} UTC`;
  document.title = `${word} · ${byId('title').textContent}`;
  drawAxes(moment.axis);
}

function drawAxes(next) {
  const drawing = byId('axes'), name = next.slice(-1);
  drawing.toggleAttribute('hidden', !next);
  drawing.setAttribute('aria-label', `rotate about ${next} of the gyro`);
  drawing.replaceChildren();
  for (const [axis, [x, y]] of Object.entries(AXES)) {
    const kind = axis === name ? { class: 'next' } : {};
    drawing.append(shape('line', { x1: 0, y1: 0, x2: x, y2: y, ...kind }),
      shape('text', { x: 1.24 * x, y: 1.24 * y, ...kind }, axis));
    if (axis !== name) continue;
    // By the right hand: about an axis that points to the viewer, against the clock.
    const angle = Math.atan2(y, x) * 180 / Math.PI;
    const turn = shape('g', { transform:
      `translate(${0.6 * x} ${0.6 * y}) rotate(${angle}) scale(1 ${next[0] === '-' ? -1 : 1})` });
    turn.append(shape('path', { class: 'next', d: 'M 3.5 14.7 A 7 17 0 1 0 -3.5 14.7' }),
      shape('path', { class: 'next', d: 'M -4.5 6.8 L -3.5 14.7 L -10.6 11.1' }));
    drawing.append(turn);
  }
}

// Stars

let unit = 0.1;                 // px of residual that the scale stands for

function fitUnit(stars) {       // 1, 2, 5: changed only where the lines would not fit
  const used = stars.filter((star) => star[5]);
  const rms = Math.sqrt(used.reduce((sum, star) => sum + star[2] ** 2 + star[3] ** 2, 0)
    / Math.max(used.length, 1));
  if (!(rms > 0) || (rms > 0.3 * unit && rms < 1.5 * unit)) return;
  const decade = 10 ** Math.floor(Math.log10(rms));
  unit = decade * ([1, 2, 5].find((step) => step * decade >= rms) || 10);
}

function drawStars({ detector, stars }) {
  const drawing = byId('detector');
  drawing.replaceChildren();
  byId('map').toggleAttribute('hidden', !detector || !stars);
  if (!detector || !stars) return;
  const [width, height] = detector, size = Math.max(width, height) / 110;
  drawing.setAttribute('viewBox', `${-size} ${-size} ${width + 2 * size} ${height + 2 * size}`);
  drawing.append(shape('rect', { class: 'edge', x: -0.5, y: -0.5, width, height }));
  fitUnit(stars);
  const stretch = SCALE * width / unit;
  for (const [u, v, du, dv, nis, used, how] of stars) {
    const star = shape('g', { class: used ? HOW[how] : 'rejected' });
    star.append(shape('title', {}, `(${u.toFixed(1)}, ${v.toFixed(1)}): residual ${
      du.toFixed(3)}, ${dv.toFixed(3)} px, NIS ${nis.toFixed(2)}${used ? '' : ', rejected'}`));
    if (used) {
      star.append(shape('line', { x1: u, y1: v, x2: u + stretch * du, y2: v + stretch * dv }),
        shape('circle', { cx: u, cy: v, r: 0.6 * size }));
    } else {
      star.append(shape('path', { d: `M ${u - size} ${v - size} l ${2 * size} ${2 * size} m 0 ${
        -2 * size} l ${-2 * size} ${2 * size}` }));
    }
    drawing.append(star);
  }
  const x = 3 * size, y = height - 3 * size;
  const scale = shape('g', { class: 'scale' });
  scale.append(shape('line', { x1: x, y1: y, x2: x + SCALE * width, y2: y }),
    shape('text', { x, y: y - 1.2 * size, 'font-size': 2.6 * size },
      `${Number(unit.toPrecision(2))} px`));
  drawing.append(scale);
  byId('stars').textContent = `${stars.filter((star) => star[5]).length} of ${stars.length
  } stars used; the scale is of the residuals, the detector has ${width} × ${height} px`;
}

// Sigmas, on a logarithmic scale

function drawStates({ states, doubt }) {
  byId('doubt').textContent = doubt;
  byId('states').classList.toggle('doubted', Boolean(doubt));
  const known = states.filter((state) => state.ratio !== null);
  const logs = known.map((state) => Math.log10(Math.max(state.ratio, 1e-9)));
  const low = Math.min(-2, Math.floor(Math.min(...logs, 0)));
  const high = Math.max(2, Math.ceil(Math.max(...logs, 0)));
  const place = (log) => (log - low) / (high - low);
  const ticks = Array.from({ length: high - low + 1 }, (_, k) => low + k);
  const spaced = ticks.filter((tick) => tick % (high - low > 6 ? 2 : 1) === 0);
  const scale = element('div', { class: 'track' });
  for (const tick of spaced) {
    const text = element('span', { class: 'at' },
      String(Number((10 ** tick).toPrecision(1))));
    text.style.left = `${100 * place(tick)}%`;
    scale.append(text);
  }
  const rows = known.map((state, k) => {
    const track = element('div', { class: 'track', role: 'img', 'aria-label':
      `sigma is ${state.ratio.toPrecision(2)} of the tolerance` },
      mark('bar', 0, Math.max(place(logs[k]), 0.004)),
      ...ticks.map((tick) => mark(tick ? 'tick' : 'limit', place(tick))));
    return element('div', { class: `row ${state.within ? 'within' : ''}` },
      element('span', { class: 'name' }, state.label),
      element('span', { class: 'number' }, `${state.estimate} ${state.of}`), track,
      element('span', { class: 'number', title: 'sigma / tolerance' },
        `${state.sigma} / ${state.tolerance} ${state.unit}`));
  });
  byId('states').replaceChildren(...(known.length ? [element('div', { class: 'row scalerow' },
    element('span', {}), element('span', {}), scale, element('span', {})), ...rows]
    : ['No state is known yet.']));
}

// Tests of the innovations, each by its place in its band

function drawTests({ tests }) {
  const failing = tests.filter((test) => !test.passed).length;
  byId('told').textContent = !tests.length ? 'There are too few frames for the tests.'
    : `${failing ? `${failing} of ${tests.length} tests of the innovations fail.`
      : `All ${tests.length} tests of the innovations pass.`
    } Each is drawn by its place in the band (shaded) that it keeps where the model is right.`;
  const extent = Math.max(2, ...tests.map((test) => Math.abs(test.place ?? 0)));
  const place = (value) => 0.5 + 0.5 * value / extent;
  byId('tests').replaceChildren(...[...tests].sort((a, b) => a.passed - b.passed).map((test) =>
    element('div', { class: `test ${test.passed ? '' : 'fails'}` },
      element('span', {}, `${test.passed ? '' : '✗ '}${test.name}`),
      element('div', { class: 'track' }, mark('band', place(-1), place(1)),
        ...(test.place === null ? [] : [mark('dot', place(test.place))])),
      element('span', { class: 'number' }, `${test.value} (${test.low} to ${test.high})`))));
}

// Inputs

function drawInputs({ inputs, rates, counts }) {
  byId('inputs').textContent = inputs;
  byId('rates').replaceChildren(...rates.map(({ topic, hz, lost }) => element('p', {},
    element('b', {}, `${hz} Hz`), topic, ...(lost !== '0' ? [`${lost} lost by the middleware`] : []))));
  byId('counts').replaceChildren(...counts.map(([name, value]) => element('div', {},
    element('dt', {}, name), element('dd', {}, value))));
}

function draw(moment) {
  for (const part of [drawVerdict, drawStars, drawStates, drawTests, drawInputs]) part(moment);
}

// Where it comes from

function lost() {
  byId('verdict').className = 'gone';
  byId('word').textContent = 'no connection';
  byId('text').textContent = 'The server has gone; the page shows what was last heard.';
}

function listen() {             // the browser connects again by itself
  const events = new EventSource('events');
  events.onmessage = ({ data }) => draw(JSON.parse(data));
  events.onerror = lost;
}

function browse(moments) {
  const slider = byId('moment');
  let wanted = -1;
  const show = async (k) => {
    wanted = k;
    const answer = await fetch(`moments/${k}`);
    const moment = await answer.json();
    if (k === wanted) draw(moment);     // an answer that comes late is of another time
  };
  slider.max = moments.length - 1;
  slider.value = slider.max;
  byId('moments').toggleAttribute('hidden', moments.length < 2);
  slider.oninput = () => {
    slider.setAttribute('aria-valuetext', moments[slider.value]);
    show(Number(slider.value)).catch(lost);
  };
  return show(moments.length - 1);
}

async function main() {
  const { title, moments } = await (await fetch('source')).json();
  byId('title').textContent = title;
  await (moments ? browse(moments) : listen());
}

main().catch(lost);
