// What is drawn on an image's canvas: frame, ties with residuals, shots before and after, ellipses, the cross.

import {roundBelow} from './plot.js';

export const COLOURS = {
  tie: '#F0E442', rejected: '#FF7A45', before: '#E69F00', after: '#56B4E9', ellipse: '#FFFFFF', measured: '#00E5A0',
};
const MARK = 4; // CSS pixels, half a mark

// Strokes twice, dark and wide beneath: to be seen on any grey
function stroke(context, path, colour, width = 1.5) {
  context.strokeStyle = 'rgba(0, 0, 0, 0.75)';
  context.lineWidth = width + 2;
  context.stroke(path);
  context.strokeStyle = colour;
  context.lineWidth = width;
  context.stroke(path);
}

export function drawFrame(context, mapping, image) {
  const corners = [[0, 0], [0, image.samples], [image.lines, image.samples], [image.lines, 0]];
  const path = new Path2D();
  corners.forEach(([line, sample], k) => path[k ? 'lineTo' : 'moveTo'](...mapping.toCanvas(line, sample)));
  path.closePath();
  if (!image.picture) {
    context.fillStyle = '#6b6b6b';
    context.fill(path);
  }
  context.strokeStyle = '#9a9a9a';
  context.lineWidth = 1;
  context.stroke(path);
}

// Ties with a place on the canvas: [{k, x, y}]
export function tiesSeen(mapping, ties, width, height) {
  const [down, right] = mapping.bounds(width, height), found = [];
  ties.measured.forEach(([line, sample], k) => {
    if (line < down[0] || line > down[1] || sample < right[0] || sample > right[1]) return;
    const [x, y] = mapping.toCanvas(line, sample);
    found.push({k, x, y});
  });
  return found;
}

export function drawTies(context, mapping, ties, seen, factor, chosen) {
  const marks = new Path2D(), out = new Path2D(), vectors = new Path2D(), own = new Path2D();
  for (const {k, x, y} of seen) {
    if (ties.used[k]) {
      marks.moveTo(x - MARK, y);
      marks.lineTo(x + MARK, y);
      marks.moveTo(x, y - MARK);
      marks.lineTo(x, y + MARK);
    } else {
      out.moveTo(x - MARK, y - MARK);
      out.lineTo(x + MARK, y + MARK);
      out.moveTo(x - MARK, y + MARK);
      out.lineTo(x + MARK, y - MARK);
    }
    const residual = ties.residuals[k];
    if (factor && residual) {
      const [line, sample] = ties.measured[k];
      vectors.moveTo(x, y);
      vectors.lineTo(...mapping.toCanvas(line + factor * residual[0], sample + factor * residual[1]));
    }
    if (ties.names[k] === chosen) {
      own.moveTo(x + 9, y);
      own.arc(x, y, 9, 0, 7);
    }
  }
  if (factor) stroke(context, vectors, COLOURS.tie, 1.2);
  stroke(context, marks, COLOURS.tie);
  stroke(context, out, COLOURS.rejected);
  stroke(context, own, COLOURS.measured, 2);
}

// Names beside the ties, of the first ones where they are many
export function drawNames(context, ties, seen) {
  context.font = '11px sans-serif';
  context.textAlign = 'left';
  context.textBaseline = 'middle';
  context.lineWidth = 3;
  context.strokeStyle = 'rgba(0, 0, 0, 0.75)';
  context.fillStyle = COLOURS.tie;
  for (const {k, x, y} of seen.slice(0, 300)) {
    context.strokeText(ties.names[k], x + 7, y - 7);
    context.fillText(ties.names[k], x + 7, y - 7);
  }
}

export function drawShots(context, mapping, shots, width, height, near) {
  const before = new Path2D(), after = new Path2D(), between = new Path2D();
  for (const profile of shots.profiles)
    profile.names.forEach((_, k) => {
      const ends = [profile.before[k], profile.after[k]].map(one => one && mapping.toCanvas(...one));
      const inside = ends.some(one => one && one[0] > -50 && one[1] > -50 && one[0] < width + 50 && one[1] < height + 50);
      if (!inside) return;
      if (ends[0]) {
        before.moveTo(ends[0][0] + MARK, ends[0][1]);
        before.arc(...ends[0], MARK, 0, 7);
      }
      if (ends[1]) {
        after.moveTo(ends[1][0], ends[1][1] - MARK);
        after.lineTo(ends[1][0] + MARK, ends[1][1] + 0.8 * MARK);
        after.lineTo(ends[1][0] - MARK, ends[1][1] + 0.8 * MARK);
        after.closePath();
      }
      if (ends[0] && ends[1]) {
        between.moveTo(...ends[0]);
        between.lineTo(...ends[1]);
      }
      if (near && near.profile === profile && near.k === k && ends[1]) {
        const ring = new Path2D();
        ring.arc(...ends[1], 10, 0, 7);
        stroke(context, ring, COLOURS.after, 2);
      }
    });
  context.strokeStyle = 'rgba(255, 255, 255, 0.45)';
  context.lineWidth = 1;
  context.stroke(between);
  stroke(context, before, COLOURS.before);
  stroke(context, after, COLOURS.after);
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
  stroke(context, path, COLOURS.ellipse, 1.4);
}

export function drawCross(context, x, y, width, height) {
  const path = new Path2D(), gap = 7;
  path.moveTo(0, y);
  path.lineTo(x - gap, y);
  path.moveTo(x + gap, y);
  path.lineTo(width, y);
  path.moveTo(x, 0);
  path.lineTo(x, y - gap);
  path.moveTo(x, y + gap);
  path.lineTo(x, height);
  context.strokeStyle = 'rgba(0, 0, 0, 0.5)';
  context.lineWidth = 2.5;
  context.stroke(path);
  context.strokeStyle = 'rgba(255, 255, 255, 0.85)';
  context.lineWidth = 1;
  context.stroke(path);
}

// A bar of a round length on the ground, `metres` of which a CSS pixel to the right takes
export function drawScale(context, metres, width, height) {
  if (!(metres > 0) || !Number.isFinite(metres)) return;
  const length = roundBelow(metres * Math.min(160, width / 3)), pixels = length / metres;
  const path = new Path2D(), x = 12, y = height - 12;
  path.moveTo(x, y - 6);
  path.lineTo(x, y);
  path.lineTo(x + pixels, y);
  path.lineTo(x + pixels, y - 6);
  stroke(context, path, '#ffffff', 1.6);
  context.font = '12px sans-serif';
  context.textAlign = 'left';
  context.textBaseline = 'bottom';
  context.lineWidth = 3;
  context.strokeStyle = 'rgba(0, 0, 0, 0.75)';
  const words = length >= 1000 ? `${length / 1000} km` : `${Number(length.toPrecision(2))} m`;
  context.strokeText(words, x + 4, y - 3);
  context.fillStyle = '#ffffff';
  context.fillText(words, x + 4, y - 3);
}

// A place measured just now, not yet stored
export function drawMeasured(context, mapping, place) {
  const [x, y] = mapping.toCanvas(...place), path = new Path2D();
  path.arc(x, y, 7, 0, 7);
  path.moveTo(x - 11, y);
  path.lineTo(x + 11, y);
  path.moveTo(x, y - 11);
  path.lineTo(x, y + 11);
  stroke(context, path, COLOURS.measured, 1.6);
}
