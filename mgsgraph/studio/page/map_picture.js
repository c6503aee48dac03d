// What the map shows, drawn on a canvas: outlines, points one by one or in cells, vectors, ellipses, relief, and the legend.

import {make, palette, roundBelow, short} from './plot.js';

const SIGNED = ['moved_up'];
const ELLIPSE = Math.sqrt(5.991); // 95 % of two dimensions
const MARKS = ['tie', 'laser', 'control', 'post'];

export class MapPicture {
  constructor(map) {
    this.map = map;
  }

  // All layers that are shown, from below upwards; pen: {context, x, y: m to pixels, width, height, ink, moved, strong}
  draw(pen) {
    const {shown, layers, points, app, candidates} = this.map;
    if (shown.relief && layers.relief) this.drawRelief(pen, layers.relief);
    if (shown.sigmas && layers.sigmas) this.drawSigmas(pen, layers.sigmas);
    if (shown.footprints && this.map.outlines) this.drawOutlines(pen);
    if (points && shown.points) points.form === 'cells' ? this.drawCells(pen) : this.drawMarks(pen);
    if (points?.form === 'points' && shown.ellipses) this.drawEllipses(pen);
    if (points && shown.moved) this.drawMoved(pen);
    if (shown.residuals && layers.residuals) this.drawResiduals(pen);
    if (shown.changes && app.last?.moved) this.drawChange(pen);
    if (shown.candidates && candidates) this.drawCandidates(pen);
    this.drawSelection(pen);
  }

  drawRelief({context, x, y}, {box, picture}) {
    context.imageSmoothingEnabled = true;
    context.drawImage(picture, x(box[0]), y(box[3]), x(box[2]) - x(box[0]), y(box[1]) - y(box[3]));
  }

  drawSigmas({context, x, y}, layer) {
    const colours = palette(), span = layer.high - layer.low || 1;
    context.globalAlpha = 0.75;
    layer.corners.forEach((one, k) => {
      context.fillStyle = colours[step((layer.values[k] - layer.low) / span)];
      context.beginPath();
      for (let c = 0; c < 8; c += 2) context.lineTo(x(one[c]), y(one[c + 1]));
      context.fill();
    });
    context.globalAlpha = 1;
  }

  drawOutlines({context, x, y, ink, width, height}) {
    context.strokeStyle = ink;
    context.lineWidth = 1;
    const {outlines} = this.map, few = outlines.length <= 12;
    context.beginPath();
    for (const outline of outlines)
      outline.forEach(([east, north], k) => (k ? context.lineTo(x(east), y(north)) : context.moveTo(x(east), y(north))));
    context.stroke();
    if (!few) return;
    context.fillStyle = ink;
    for (const [k, outline] of outlines.entries()) {
      const top = outline.reduce((best, one) => (one[1] > best[1] ? one : best), [0, -Infinity]);
      if (outline.length && x(top[0]) > 0 && x(top[0]) < width && y(top[1]) > 0 && y(top[1]) < height)
        context.fillText(this.map.app.scene.images[k].name, x(top[0]) + 4, y(top[1]) - 4 - 14 * (k % 3));
    }
  }

  share(value) {
    const {low, high} = this.map.points, ends = this.signed() ? Math.max(Math.abs(low), Math.abs(high)) : 0;
    return this.signed() ? 0.5 + 0.5 * value / (ends || 1) : (value - low) / (high - low || 1);
  }

  signed() {
    return SIGNED.includes(this.map.points?.value);
  }

  drawCells({context, x, y}) {
    const {columns, rows, box, cells, values} = this.map.points, colours = palette(this.signed());
    const wide = (x(box[2]) - x(box[0])) / columns, high = (y(box[1]) - y(box[3])) / rows;
    cells.forEach((cell, k) => {
      const column = cell % columns, row = Math.floor(cell / columns);
      context.fillStyle = values[k] === null ? '#888' : colours[step(this.share(values[k]))];
      context.fillRect(x(box[0]) + column * wide, y(box[1]) - (row + 1) * high, Math.max(wide, 1), Math.max(high, 1));
    });
  }

  drawMarks({context, x, y, ink}) {
    const {x: east, y: north, values, classes} = this.map.points, colours = palette(this.signed());
    const size = east.length > 1500 ? 2 : 3.5;
    context.strokeStyle = ink;
    context.lineWidth = 0.5;
    east.forEach((one, k) => {
      const [a, b] = [x(one), y(north[k])];
      context.fillStyle = values[k] === null ? '#888' : colours[step(this.share(values[k]))];
      mark(context, MARKS[classes[k]], a, b, size);
    });
  }

  enlarged(longest, most) {
    const wanted = Number(this.map.factor.value);
    if (wanted > 0) return wanted;
    if (!(longest > 0)) return 1;
    return roundBelow(most / (longest * this.map.view.scale));
  }

  drawEllipses({context, x, y, strong}) {
    const {x: east, y: north, covariance: [ee, en, nn]} = this.map.points, sizes = ee.map((one, k) => Math.sqrt(Math.max(one, nn[k])));
    const factor = this.ellipseFactor = this.enlarged(quantile(sizes.filter(Number.isFinite), 0.9) * ELLIPSE, 25);
    context.strokeStyle = strong;
    context.lineWidth = 1;
    east.forEach((one, k) => {
      if (ee[k] === null) return;
      const middle = (ee[k] + nn[k]) / 2, half = Math.hypot((ee[k] - nn[k]) / 2, en[k]);
      const a = Math.sqrt(Math.max(middle + half, 0)), b = Math.sqrt(Math.max(middle - half, 0)), turn = 0.5 * Math.atan2(2 * en[k], ee[k] - nn[k]);
      const enlarge = factor * ELLIPSE * this.map.view.scale;
      context.beginPath();
      context.ellipse(x(one), y(north[k]), Math.max(a * enlarge, 0.5), Math.max(b * enlarge, 0.5), -turn, 0, 2 * Math.PI);
      context.stroke();
    });
  }

  arrows({context, x, y}, places, vectors, most = 45) {
    const lengths = vectors.map(one => Math.hypot(one[0], one[1])).filter(Number.isFinite);
    const factor = this.enlarged(quantile(lengths, 0.95), most);
    context.lineWidth = 1.2;
    context.beginPath();
    vectors.forEach((one, k) => {
      if (one[0] === null || one[1] === null) return;
      const from = [x(places[k][0]), y(places[k][1])];
      const to = [from[0] + one[0] * factor * this.map.view.scale, from[1] - one[1] * factor * this.map.view.scale];
      const angle = Math.atan2(to[1] - from[1], to[0] - from[0]), head = Math.min(6, 0.4 * Math.hypot(to[0] - from[0], to[1] - from[1]));
      context.moveTo(...from);
      context.lineTo(...to);
      context.lineTo(to[0] - head * Math.cos(angle - 0.5), to[1] - head * Math.sin(angle - 0.5));
      context.moveTo(...to);
      context.lineTo(to[0] - head * Math.cos(angle + 0.5), to[1] - head * Math.sin(angle + 0.5));
    });
    context.stroke();
    return factor;
  }

  drawMoved(pen) {
    const {points} = this.map;
    pen.context.strokeStyle = pen.strong;
    let places, vectors;
    if (points.form === 'points') {
      places = points.x.map((one, k) => [one, points.y[k]]);
      vectors = points.moved[0].map((one, k) => [one, points.moved[1][k]]);
    } else {
      const {columns, box, cells, rows} = points, wide = (box[2] - box[0]) / columns, high = (box[3] - box[1]) / rows;
      const chosen = cells.map((cell, k) => [cell, k]).filter(([cell]) => cell % columns % 5 === 2 && Math.floor(cell / columns) % 5 === 2);
      places = chosen.map(([cell]) => [box[0] + (cell % columns + 0.5) * wide, box[1] + (Math.floor(cell / columns) + 0.5) * high]);
      vectors = chosen.map(([, k]) => [points.moved[0][k], points.moved[1][k]]);
    }
    this.movedFactor = this.arrows(pen, places, vectors);
  }

  drawResiduals(pen) {
    const {places, vectors} = this.map.layers.residuals;
    pen.context.strokeStyle = pen.ink;
    this.residualFactor = this.arrows(pen, places, vectors, 30);
  }

  drawChange(pen) {
    const {last} = this.map.app, moved = last.moved.filter(one => one.map_m && one.vector_m);
    pen.context.strokeStyle = pen.moved;
    pen.context.lineWidth = 2;
    for (const one of last.moved.filter(one => one.map_m && one.sigmas === null)) {
      pen.context.beginPath();
      pen.context.arc(pen.x(one.map_m[0]), pen.y(one.map_m[1]), 5, 0, 2 * Math.PI);
      pen.context.stroke();
    }
    this.changeFactor = this.arrows(pen, moved.map(one => one.map_m), moved.map(one => one.vector_m), 60);
  }

  drawCandidates({context, x, y, moved}) {
    context.strokeStyle = context.fillStyle = moved;
    context.lineWidth = 2;
    this.map.candidates.filter(one => one.map_m).forEach((one, k) => {
      const [a, b] = [x(one.map_m[0]), y(one.map_m[1])];
      context.strokeRect(a - 7, b - 7, 14, 14);
      context.fillText(String(k + 1), a + 9, b + 4);
    });
  }

  drawSelection({context, x, y, moved}) {
    context.strokeStyle = moved;
    context.lineWidth = 2;
    for (const [east, north] of (this.map.selection.found?.places || [])) {
      context.beginPath();
      context.arc(x(east), y(north), 6, 0, 2 * Math.PI);
      context.stroke();
    }
    const at = this.map.placeOf(this.map.app.selection);
    if (!at) return;
    context.lineWidth = 3;
    context.beginPath();
    context.arc(x(at[0]), y(at[1]), 9, 0, 2 * Math.PI);
    context.stroke();
  }

  drawScaleBar(context, w, h) {
    const length = roundBelow(140 / this.map.view.scale), wide = length * this.map.view.scale;
    const style = getComputedStyle(this.map.canvas), words = length >= 1000 ? `${length / 1000} km` : `${length} m`;
    context.font = `12px ${style.fontFamily}`;
    context.fillStyle = style.getPropertyValue('--paper');
    context.globalAlpha = 0.85;
    context.fillRect(8, h - 34, wide + 60, 28);
    context.globalAlpha = 1;
    context.fillStyle = context.strokeStyle = style.color;
    context.lineWidth = 2;
    context.beginPath();
    context.moveTo(14, h - 18);
    context.lineTo(14, h - 13);
    context.lineTo(14 + wide, h - 13);
    context.lineTo(14 + wide, h - 18);
    context.stroke();
    context.fillText(words, 18, h - 20);
    context.fillText('N ↑', w - 34, 18);
  }

  // What the colours, marks and lengths mean
  legend() {
    const {points} = this.map;
    if (!points) return [];
    const bar = make('canvas', {className: 'legend-bar', width: 320, height: 14}), context = bar.getContext('2d');
    palette(this.signed()).forEach((one, k) => {
      context.fillStyle = one;
      context.fillRect(5 * k, 0, 5, 14);
    });
    const most = Math.max(Math.abs(points.low), Math.abs(points.high)), ends = this.signed() ? [-most, most] : [points.low, points.high];
    const form = points.form === 'cells' ? `${points.count} points in and around the window, medians of cells` : `${points.count} points in and around the window`;
    const factors = [
      this.map.shown.ellipses && points.form === 'points' && `ellipses × ${short(this.ellipseFactor)}`,
      this.map.shown.moved && `corrections × ${short(this.movedFactor)}`,
      this.map.shown.residuals && this.map.layers.residuals && `residuals of ${this.map.layers.residuals.image} on the ground × ${short(this.residualFactor)}, median ${short(this.map.layers.residuals.median_px)} px`,
      this.map.shown.changes && this.map.app.last?.moved && `last change × ${short(this.changeFactor)}`,
      this.map.shown.sigmas && this.map.layers.sigmas && `cells: ${this.map.layers.sigmas.sentence}`,
    ].filter(Boolean).join('; ');
    return [
      make('strong', {textContent: `${points.title} (${points.unit})`}), bar,
      make('div', {className: 'legend-ends'}, make('span', {textContent: short(ends[0])}), make('span', {textContent: short(ends[1])})),
      make('p', {className: 'caption', textContent: `${form}; colors end at the 98 % quantile of the block. Marks: ● tie, ▲ laser, ■ control, ◆ post of a terrain model.${factors ? ` ${factors}.` : ''}`}),
    ];
  }
}

function step(share) {
  return Math.min(Math.max(Math.floor(64 * share), 0), 63);
}

function quantile(values, share) {
  if (!values.length) return 0;
  const sorted = [...values].sort((a, b) => a - b);
  return sorted[Math.min(sorted.length - 1, Math.floor(share * sorted.length))];
}

function mark(context, kind, a, b, size) {
  context.beginPath();
  if (kind === 'laser') {
    context.moveTo(a, b - size);
    context.lineTo(a + size, b + size);
    context.lineTo(a - size, b + size);
    context.closePath();
  } else if (kind === 'control') context.rect(a - size, b - size, 2 * size, 2 * size);
  else if (kind === 'post') {
    context.moveTo(a, b - size);
    context.lineTo(a + size, b);
    context.lineTo(a, b + size);
    context.lineTo(a - size, b);
    context.closePath();
  } else context.arc(a, b, size, 0, 2 * Math.PI);
  context.fill();
  if (size > 3) context.stroke();
}
