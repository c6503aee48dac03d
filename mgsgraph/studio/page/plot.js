// Parts that all panels are made of: elements of the page, numbers as texts, and axes and colors for diagrams on a canvas.

import {ask} from './app.js';

const MARGIN = {left: 74, right: 14, top: 12, bottom: 40};

export function make(tag, properties = {}, ...children) {
  const element = document.createElement(tag);
  for (const [key, value] of Object.entries(properties))
    key in element ? (element[key] = value) : element.setAttribute(key, value);
  element.append(...children);
  return element;
}

export const button = (textContent, onclick, more = {}) => make('button', {type: 'button', textContent, onclick, ...more});

// A button that takes away what its title says
export const remover = (title, onclick) => button('×', onclick, {title, ariaLabel: title});

export const caption = textContent => make('p', {className: 'caption', textContent});

export const check = (words, checked, act, more = {}) => make('label', more,
  make('input', {type: 'checkbox', checked, onchange: ({target}) => act(target.checked)}), ` ${words}`);

// Options of a select, by their values and words
export const options = pairs => pairs.map(([value, words = value]) => new Option(words, value));

// Puts other options into a select, which keeps its choice where it can
export function refill(select, pairs) {
  const {value} = select;
  select.replaceChildren(...options(pairs));
  if (pairs.some(([one]) => one === value)) select.value = value;
}

// A form whose button of type submit, or Enter, stores what Escape gives up
export function form(className, ariaLabel, store, cancel, ...parts) {
  const onsubmit = event => { event.preventDefault(); store(); };
  return make('form', {className, ariaLabel, onsubmit, onkeydown: event => { if (event.key === 'Escape') cancel(); }}, ...parts);
}

// A titled table of cells, texts or elements (numbers to the right); the words stand in the place of no rows
export function table(title, columns, rows, words = '') {
  const cell = one => one instanceof HTMLTableCellElement ? one : make('td', {className: /^[−–\d]/.test(one) ? 'number' : ''}, ...[one].flat());
  const head = make('tr', {}, ...columns.map(textContent => make('th', {scope: 'col', textContent})));
  const body = rows.map(cells => make('tr', {}, ...cells.map(cell)));
  return make('section', {}, title && make('h3', {textContent: title}), rows.length
    ? make('div', {className: 'scroll', tabIndex: 0, role: 'region', ariaLabel: title || 'Table'}, make('table', {}, make('thead', {}, head), make('tbody', {}, ...body)))
    : caption(words));
}

// Saves a blob, or what an address gives, as a file; a link to the address could not send the secret
export function save(blob, name) {
  const href = URL.createObjectURL(blob);
  make('a', {href, download: name}).click();
  setTimeout(() => URL.revokeObjectURL(href), 60000);
}

export const download = async (address, name) => save(await (await ask(address)).blob(), name);

// The largest of 1, 2 and 5 times a power of ten that a value holds
export function roundBelow(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  return [5, 2, 1].map(one => one * power).find(one => one <= value) || power;
}

// Round steps between two values, about `count` of them
export function ticks(low, high, count) {
  const raw = (high - low) / Math.max(count, 1), power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map(one => one * power).find(one => one >= raw) || 10 * power;
  const found = [];
  for (let value = Math.ceil(low / step) * step; value <= high + 1e-9 * step; value += step)
    found.push(Math.abs(value) < 1e-9 * step ? 0 : value);
  return found;
}

export function short(value, digits = 3) {
  if (value === null || !Number.isFinite(value)) return '–';
  const text = Math.abs(value) >= 1e5 || (value && Math.abs(value) < 1e-3) ? value.toExponential(digits - 1)
    : String(Number(value.toPrecision(Math.max(digits, Math.ceil(Math.log10(Math.abs(value) + 1))))));
  return text.replace('-', '−');
}

// Prepares a canvas for the density of the screen; returns its context and size in CSS pixels
export function prepared(canvas, width = canvas.clientWidth, height = canvas.clientHeight) {
  const density = window.devicePixelRatio || 1, size = {width: Math.round(width * density), height: Math.round(height * density)};
  if (canvas.width !== size.width || canvas.height !== size.height) Object.assign(canvas, size);
  const context = canvas.getContext('2d');
  context.setTransform(density, 0, 0, density, 0, 0);
  return {context, width, height, density};
}

export function pageColors(element) {
  const style = getComputedStyle(element);
  const [before, after] = ['--before', '--after'].map(key => style.getPropertyValue(key));
  return {ink: style.color, soft: 'rgba(128, 128, 128, 0.35)', font: `12px ${style.fontFamily}`, before, after};
}

export function trace(context, positions) {
  context.beginPath();
  for (const [x, y] of positions) context.lineTo(x, y);
  context.stroke();
}

// A text with a rim, which can be read on any ground
export function label(context, words, x, y, color = '#ffffff', rim = 'rgba(0, 0, 0, 0.75)') {
  Object.assign(context, {lineWidth: 3, lineJoin: 'round', strokeStyle: rim, fillStyle: color});
  context.strokeText(words, x, y);
  context.fillText(words, x, y);
}

// Axes over x and y ranges; returns {context, toX(), toY(), inverse(), box, colors}
export function axes(canvas, {x, y, xLabel, yLabel}) {
  const {context, width, height} = prepared(canvas), colors = pageColors(canvas);
  const box = {left: MARGIN.left, top: MARGIN.top, right: width - MARGIN.right, bottom: height - MARGIN.bottom};
  const across = (box.right - box.left) / (x[1] - x[0]), up = (box.bottom - box.top) / (y[1] - y[0]);
  const toX = value => box.left + (value - x[0]) * across, toY = value => box.bottom - (value - y[0]) * up;
  context.clearRect(0, 0, width, height);
  Object.assign(context, {font: colors.font, fillStyle: colors.ink, strokeStyle: colors.soft, lineWidth: 1, textAlign: 'center', textBaseline: 'top'});
  for (const value of ticks(Math.min(...x), Math.max(...x), Math.max(2, (box.right - box.left) / 90))) {
    trace(context, [[toX(value), box.top], [toX(value), box.bottom]]);
    context.fillText(short(value, 6), toX(value), box.bottom + 5);
  }
  Object.assign(context, {textAlign: 'right', textBaseline: 'middle'});
  for (const value of ticks(Math.min(...y), Math.max(...y), Math.max(4, (box.bottom - box.top) / 45))) {
    trace(context, [[box.left, toY(value)], [box.right, toY(value)]]);
    context.fillText(short(value, 6), box.left - 6, toY(value));
  }
  context.strokeStyle = colors.ink;
  context.strokeRect(box.left, box.top, box.right - box.left, box.bottom - box.top);
  Object.assign(context, {textAlign: 'center', textBaseline: 'bottom'});
  context.fillText(xLabel, (box.left + box.right) / 2, box.bottom + MARGIN.bottom - 2);
  context.save();
  context.translate(11, (box.top + box.bottom) / 2);
  context.rotate(-Math.PI / 2);
  context.textBaseline = 'middle';
  context.fillText(yLabel, 0, 0);
  context.restore();
  const inverse = (px, py) => [x[0] + (px - box.left) / across, y[0] + (box.bottom - py) / up];
  return {context, toX, toY, inverse, box, colors};
}

// Range of numbers with a margin; null where there are none
export function range(values, margin = 0.06) {
  let low = Infinity, high = -Infinity;
  for (const value of values)
    if (value !== null && Number.isFinite(value)) {
      if (value < low) low = value;
      if (value > high) high = value;
    }
  if (low > high) return null;
  const more = Math.max(margin * (high - low), 1e-9 * Math.abs(high)) || 1; // steps that add nothing would never end
  return [low - more, high + more];
}

// Color of a share 0 .. 1: dark blue to yellow, evenly light (after viridis, at seven stations)
const STATIONS = [[68, 1, 84], [70, 50, 127], [54, 92, 141], [39, 127, 142], [31, 161, 135], [109, 205, 89], [253, 231, 37]];
export function color(share) {
  const at = Math.max(0, Math.min(1, share)) * (STATIONS.length - 1), k = Math.min(Math.floor(at), STATIONS.length - 2);
  return STATIONS[k].map((one, c) => Math.round(one + (at - k) * (STATIONS[k + 1][c] - one)));
}

// Red for above zero, blue for below, white between
export function twoSided(share) {
  const at = Math.max(-1, Math.min(1, share)), far = at < 0 ? [33, 102, 172] : [178, 24, 43];
  return far.map(one => Math.round(247 + Math.abs(at) * (one - 247)));
}

// 64 colors for drawing many marks: of amounts, or of what has a sign
export function palette(signed = false) {
  return Array.from({length: 64}, (_, k) => `rgb(${(signed ? twoSided((k + 0.5) / 32 - 1) : color((k + 0.5) / 64)).join(',')})`);
}
