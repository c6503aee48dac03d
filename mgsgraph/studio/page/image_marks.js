// What is drawn on an image's canvas: frame, grid, ties with residuals, shots before and after, ellipses, the cross.

import {label, roundBelow, short, ticks} from './plot.js';

export const COLORS = {
  tie: '#F0E442', rejected: '#FF7A45', before: '#E69F00', after: '#56B4E9', ellipse: '#FFFFFF', measured: '#00E5A0', other: '#C9A7FF',
};
const MARK = 4; // CSS pixels, half a mark
const TIES = 24, SHOTS = 40; // CSS pixels, about: cells of the screen with one mark each

// Strokes twice, dark and wide beneath: to be seen on any gray
function stroke(context, path, color, width = 1.5, rim = 0.75) {
  for (const [strokeStyle, lineWidth] of [[`rgba(0, 0, 0, ${rim})`, width + 2], [color, width]]) {
    Object.assign(context, {strokeStyle, lineWidth});
    context.stroke(path);
  }
}

// The edges of an image, with pixels or without; of another image than the canvas has, with its name
export function drawFrame(context, mapping, image, other = '') {
  const corners = [[0, 0], [0, image.samples], [image.lines, image.samples], [image.lines, 0]];
  const path = new Path2D();
  corners.forEach(([line, sample], k) => path[k ? 'lineTo' : 'moveTo'](...mapping.toCanvas(line, sample)));
  path.closePath();
  if (!other && !image.picture) {
    context.fillStyle = '#404850';
    context.fill(path);
  }
  Object.assign(context, {strokeStyle: other ? COLORS.other : '#9a9a9a', lineWidth: 1});
  context.stroke(path);
  if (!other) return;
  const [x, y] = corners.map(one => mapping.toCanvas(...one)).sort((one, next) => one[0] - next[0] || one[1] - next[1])[0];
  Object.assign(context, {font: '11px sans-serif', textAlign: 'left', textBaseline: 'bottom'});
  label(context, other, x, y, COLORS.other);
}

// Round lines and samples, in place of pixels; each has its number where it is first seen
export function drawGrid(context, mapping, {lines, samples}, width, height) {
  const path = new Path2D(), bounds = mapping.bounds(width, height);
  const first = bounds.map(one => Math.max(one[0], 0)), last = bounds.map((one, k) => Math.min(one[1], [lines, samples][k]));
  Object.assign(context, {font: '11px sans-serif', textAlign: 'left', textBaseline: 'top'});
  ['line', 'sample'].forEach((name, k) => {
    if (!(last[k] > first[k])) return;
    for (const value of ticks(first[k], last[k], mapping.scale * (last[k] - first[k]) / 110)) {
      const ends = [first, last].map(one => mapping.toCanvas(...(k ? [one[0], value] : [value, one[1]])));
      segments(path, ends.flat());
      const [x, y] = ends.find(([px, py]) => px >= 0 && py >= 0 && px < width - 60 && py < height - 12) || ends[0];
      label(context, `${name} ${short(value, 6)}`, x + 3, y + 2, '#e4e9ee');
    }
  });
  stroke(context, path, '#7d8894', 1, 0);
}

// Ties by their residuals in sigmas, the largest first
export function worstFirst({names, residuals, sigmas}) {
  const sizes = residuals.map((one, k) => one ? Math.hypot(one[0] / sigmas[k][0], one[1] / sigmas[k][1]) : -1);
  return names.map((_, k) => k).sort((a, b) => sizes[b] - sizes[a]);
}

// Whether a place is the first one in its cell; cells move with the image, for marks would come and go while it is panned
function firstInCell(mapping, cell) {
  const side = cell / 2 ** Math.round(Math.log2(mapping.scale)), taken = new Set();
  return (line, sample) => taken.size < taken.add(Math.floor(line / side) * 1e6 + Math.floor(sample / side)).size;
}

// Ties on the canvas that are drawn, [{k, x, y}]: the chosen one, and of others in a cell the worst; `all` counts them
export function tiesSeen(mapping, {ties, order}, width, height, chosen) {
  const found = Object.assign([], {all: 0}), isFirst = firstInCell(mapping, TIES);
  for (const k of order) {
    const [x, y] = mapping.toCanvas(...ties.measured[k]);
    if (x < 0 || y < 0 || x > width || y > height) continue;
    found.all += 1;
    if (isFirst(...ties.measured[k]) || ties.names[k] === chosen) found.push({k, x, y});
  }
  return found;
}

// Line segments from x, y to x, y
function segments(path, ...ends) {
  for (const [x0, y0, x1, y1] of ends) {
    path.moveTo(x0, y0);
    path.lineTo(x1, y1);
  }
}

function circle(path, x, y, radius) {
  path.moveTo(x + radius, y);
  path.arc(x, y, radius, 0, 7);
}

function triangle(path, x, y) {
  path.moveTo(x, y - MARK);
  path.lineTo(x + MARK, y + 0.8 * MARK);
  path.lineTo(x - MARK, y + 0.8 * MARK);
  path.closePath();
}

export function drawTies(context, mapping, ties, seen, factor, chosen) {
  const marks = new Path2D(), out = new Path2D(), vectors = new Path2D(), own = new Path2D();
  for (const {k, x, y} of seen) {
    if (ties.used[k]) segments(marks, [x - MARK, y, x + MARK, y], [x, y - MARK, x, y + MARK]);
    else segments(out, [x - MARK, y - MARK, x + MARK, y + MARK], [x - MARK, y + MARK, x + MARK, y - MARK]);
    const residual = ties.residuals[k];
    if (factor && residual) {
      const [line, sample] = ties.measured[k];
      segments(vectors, [x, y, ...mapping.toCanvas(line + factor * residual[0], sample + factor * residual[1])]);
    }
    if (ties.names[k] === chosen) circle(own, x, y, 9);
  }
  if (factor) stroke(context, vectors, COLORS.tie, 1.2);
  stroke(context, marks, COLORS.tie);
  stroke(context, out, COLORS.rejected);
  stroke(context, own, COLORS.measured, 2);
}

// Names beside the ties, of the first ones where they are many
export function drawNames(context, ties, seen) {
  Object.assign(context, {font: '11px sans-serif', textAlign: 'left', textBaseline: 'middle'});
  for (const {k, x, y} of seen.slice(0, 300)) label(context, ties.names[k], x + 7, y - 7, COLORS.tie);
}

// Shots before and after, one in a cell; returns how many of those on the canvas
export function drawShots(context, mapping, shots, width, height, near) {
  const before = new Path2D(), after = new Path2D(), between = new Path2D(), ring = new Path2D(), isFirst = firstInCell(mapping, SHOTS);
  const counts = {drawn: 0, all: 0};
  for (const profile of shots.profiles)
    profile.names.forEach((_, k) => {
      const ends = [profile.before[k], profile.after[k]].map(one => one && mapping.toCanvas(...one));
      const inside = ends.some(one => one && one[0] > -50 && one[1] > -50 && one[0] < width + 50 && one[1] < height + 50);
      if (!inside) return;
      counts.all += 1;
      const isNear = near && near.profile === profile && near.k === k;
      if (!isFirst(...(profile.after[k] || profile.before[k])) && !isNear) return;
      counts.drawn += 1;
      if (ends[0]) circle(before, ...ends[0], MARK);
      if (ends[1]) triangle(after, ...ends[1]);
      if (ends[0] && ends[1]) segments(between, ends.flat());
      if (isNear && ends[1]) circle(ring, ...ends[1], 10);
    });
  stroke(context, between, 'rgba(255, 255, 255, 0.45)', 1, 0);
  stroke(context, before, COLORS.before);
  stroke(context, after, COLORS.after);
  stroke(context, ring, COLORS.after, 2);
  return counts;
}

// An error ellipse in pixels of the image about [line, sample]; one that is smaller than can be seen is a dot.
export function drawEllipse(context, mapping, place, ellipse) {
  const path = new Path2D(), [large, small] = ellipse.semi_axes_px, turn = ellipse.angle_deg * Math.PI / 180;
  for (let k = 0; k <= 48; k++) {
    const angle = 2 * Math.PI * k / 48, along = large * Math.cos(angle), across = small * Math.sin(angle);
    const sample = along * Math.cos(turn) - across * Math.sin(turn);
    const line = along * Math.sin(turn) + across * Math.cos(turn);
    path[k ? 'lineTo' : 'moveTo'](...mapping.toCanvas(place[0] + line, place[1] + sample));
  }
  stroke(context, path, COLORS.ellipse, 1.4);
}

export function drawCross(context, x, y, width, height) {
  const path = new Path2D(), gap = 7;
  segments(path, [0, y, x - gap, y], [x + gap, y, width, y], [x, 0, x, y - gap], [x, y + gap, x, height]);
  stroke(context, path, 'rgba(255, 255, 255, 0.85)', 1, 0.3);
}

// A bar of a round length on the ground, `metres` of which a CSS pixel to the right takes
export function drawScale(context, metres, width, height) {
  if (!(metres > 0) || !Number.isFinite(metres)) return;
  const length = roundBelow(metres * Math.min(160, width / 3)), pixels = length / metres;
  const path = new Path2D(), x = 12, y = height - 12;
  segments(path, [x, y - 6, x, y], [x, y, x + pixels, y], [x + pixels, y, x + pixels, y - 6]);
  stroke(context, path, '#ffffff', 1.6);
  Object.assign(context, {font: '12px sans-serif', textAlign: 'left', textBaseline: 'bottom'});
  label(context, length >= 1000 ? `${length / 1000} km` : `${Number(length.toPrecision(2))} m`, x + 4, y - 3);
}

// A place measured just now, not yet stored
export function drawMeasured(context, mapping, place) {
  const [x, y] = mapping.toCanvas(...place), path = new Path2D();
  circle(path, x, y, 7);
  segments(path, [x - 11, y, x + 11, y], [x, y - 11, x, y + 11]);
  stroke(context, path, COLORS.measured, 1.6);
}
