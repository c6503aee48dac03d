// Registration: shots in the images before and after, the search by relief with its profiles, heights above the terrain.

import {COLOURS} from './image_marks.js';
import {axes, colour, make, range, short, twoSided} from './plot.js';

const TOP = 5; // sigmas, upper end of the colours of a cost surface at least

export class Registration {
  constructor(app, element) {
    Object.assign(this, {app, element, record: null, revision: null});
    element.classList.add('registration');
    app.addEventListener('opened', () => this.load());
    app.addEventListener('renewed', () => this.load());
    new ResizeObserver(() => this.draw()).observe(element);
    new IntersectionObserver(() => this.load()).observe(element);
    if (app.scene) this.load();
  }

  // Read it once it is looked at, and again after a change
  async load() {
    const revision = this.app.scene?.revision;
    if (!this.app.scene || this.element.offsetParent === null || this.revision === revision) return;
    this.revision = revision;
    try {
      this.record = await this.app.request('/api/registration');
      this.build();
    } catch (error) {
      this.revision = null;
      this.app.say(error.message, 'error');
    }
  }

  build() {
    const {footprints, relief, heights, minima, missing} = this.record;
    this.drawn = [];
    const sections = [this.footprints(footprints)];
    sections.push(relief ? this.relief(relief) : this.section('Search by relief', missing.relief));
    sections.push(heights ? this.heights(heights) : this.section('Heights above the terrain model', missing.heights));
    if (minima && minima.each.length > 1) sections.push(this.minima(minima));
    this.element.replaceChildren(...sections);
    this.draw();
  }

  draw() {
    if (this.element.offsetParent !== null) for (const one of this.drawn || []) one();
  }

  section(title, ...sentences) {
    const section = make('section', {}, make('h2', {textContent: title}));
    if (sentences.length === 1) section.append(make('p', {textContent: sentences[0]}));
    else section.append(make('ul', {}, ...sentences.map(one => make('li', {textContent: one}))));
    return section;
  }

  // A diagram with its caption, drawn again when the page changes its size
  diagram(section, height, draw, caption) {
    const canvas = make('canvas', {className: 'diagram'});
    canvas.style.height = `${height}px`;
    canvas.setAttribute('role', 'img');
    const words = make('figcaption', {className: 'caption'});
    section.append(make('figure', {}, canvas, words));
    const again = () => {
      if (!canvas.clientWidth) return;
      draw(canvas);
      words.textContent = typeof caption === 'function' ? caption() : caption;
      canvas.setAttribute('aria-label', words.textContent);
    };
    this.drawn.push(again);
    return again;
  }

  chooser(section, words, names, act) {
    const select = make('select', {});
    names.forEach((name, k) => select.append(make('option', {value: k, textContent: name})));
    select.addEventListener('change', () => act(Number(select.value)));
    section.append(make('label', {}, `${words} `, select));
  }

  // Links to the view as a figure; `chosen` says, when one is followed, of what
  saving(section, view, chosen = () => ({})) {
    const links = make('p', {className: 'save-figure'}, 'Save as ');
    for (const kind of ['svg', 'png', 'pdf']) {
      const file = `${view}.${kind}`, link = make('a', {href: `/api/figure/${file}`, download: file, textContent: kind.toUpperCase()});
      link.addEventListener('click', () => { link.href = `/api/figure/${file}?${new URLSearchParams(chosen())}`; });
      links.append(link, ' ');
    }
    section.append(links);
  }

  // --- footprints

  footprints(record) {
    const section = this.section('Shots in the images', record.sentence);
    if (!record.images.length) return section;
    let chosen = record.images[0];
    this.chooser(section, 'Image', record.images.map(one => one.image), k => {
      chosen = record.images[k];
      again();
    });
    const again = this.diagram(section, 300, canvas => {
      // the image on its side: lines to the right, so that long images find room
      const drawn = axes(canvas, {
        x: [0, chosen.lines], y: [0, chosen.samples], xLabel: 'line (px)', yLabel: 'sample (px)',
      });
      const {context, toX, toY, colours} = drawn;
      for (const profile of chosen.profiles)
        profile.names.forEach((_, k) => {
          const [before, after] = [profile.before[k], profile.after[k]];
          if (before && after) {
            context.strokeStyle = colours.soft;
            context.beginPath();
            context.moveTo(toX(before[0]), toY(before[1]));
            context.lineTo(toX(after[0]), toY(after[1]));
            context.stroke();
          }
          if (before) ring(context, toX(before[0]), toY(before[1]), 3.5, COLOURS.before);
          if (after) dot(context, toX(after[0]), toY(after[1]), 2.5, '#0072B2');
        });
    }, () => `${chosen.sentence} Orange rings: before, as archived with the nominal orientation; blue dots: after, both `
      + 'adjusted; the image lies on its side.');
    this.saving(section, 'footprints', () => ({image: chosen.image}));
    return section;
  }

  // --- search by relief

  relief(record) {
    const section = this.section('Search by relief', ...record.sentences);
    let chosen = record.profiles[0];
    const redraw = [];
    this.chooser(section, 'Profile', record.profiles.map(one => one.name), k => {
      chosen = record.profiles[k];
      redraw.forEach(one => one());
    });
    const row = make('div', {className: 'diagram-row'});
    section.append(row);
    for (const state of ['before', 'after'])
      redraw.push(this.diagram(row, 380, canvas => drawCost(canvas, chosen.costs[state]),
        () => costWords(chosen, state)));
    redraw.push(this.diagram(section, 260, canvas => drawHeights(canvas, chosen.shots), () => heightWords(chosen)));
    redraw.push(this.diagram(section, 220, canvas => drawOff(canvas, chosen.shots),
      'Height of each shot above the surface that the images show, with its a-priori sigma: orange before, blue after.'));
    section.append(make('p', {textContent: 'As figures: costs.png and profiles.png in the folder of results.'}));
    return section;
  }

  // --- heights above the terrain model

  heights(record) {
    const section = this.section('Heights above the terrain model, in two steps', ...record.sentences);
    const row = make('div', {className: 'diagram-row'});
    section.append(row);
    const last = record.stages.length - 1;
    for (const [what, values, words] of [['rms', record.rms_m, 'Root mean square'], ['mean', record.mean_m, 'Mean']])
      for (const stage of [0, last]) {
        const name = ['before', 'after step 1', 'after step 2'][stage];
        this.diagram(row, 360, canvas => drawCells(canvas, record, values, stage, what === 'mean'),
          () => cellWords(record, values, stage, what === 'mean', words, name));
      }
    section.append(make('p', {textContent: 'As a figure: height_map.png in the folder of results.'}));
    return section;
  }

  // --- minima

  minima(record) {
    const section = this.section('Several places at which the terrain model fits',
      `By ${record.starts} starts over its shift; ellipses are one sigma, per cent the probability of each.`);
    this.diagram(section, 380, canvas => {
      const reach = Math.max(...record.each.map(one => Math.max(...one.shift_m.map(Math.abs))
        + Math.sqrt(Math.max(one.covariance_m2[0][0], one.covariance_m2[1][1])))) * 1.1;
      const drawn = axes(canvas, {
        x: [-reach, reach], y: [-reach, reach], xLabel: 'shift east (m)', yLabel: 'shift north (m)', equal: true,
      });
      record.each.forEach((one, k) => {
        ellipse(drawn, one.shift_m, one.covariance_m2, k ? COLOURS.before : '#0072B2');
        drawn.context.fillStyle = drawn.colours.ink;
        drawn.context.textAlign = 'left';
        drawn.context.fillText(`${Math.round(100 * one.weight)} %`, drawn.toX(one.shift_m[0]) + 7, drawn.toY(one.shift_m[1]) - 7);
      });
    }, 'Blue: the solution; orange: other minima.');
    this.saving(section, 'minima');
    return section;
  }
}

function dot(context, x, y, radius, fill) {
  context.fillStyle = fill;
  context.beginPath();
  context.arc(x, y, radius, 0, 7);
  context.fill();
}

function ring(context, x, y, radius, stroke) {
  context.strokeStyle = stroke;
  context.lineWidth = 1.3;
  context.beginPath();
  context.arc(x, y, radius, 0, 7);
  context.stroke();
}

// One sigma about a shift
function ellipse({context, toX, toY}, [east, north], [[xx, xy], [, yy]], stroke) {
  const middle = (xx + yy) / 2, off = Math.hypot((xx - yy) / 2, xy), turn = 0.5 * Math.atan2(2 * xy, xx - yy);
  const large = Math.sqrt(Math.max(middle + off, 0)), small = Math.sqrt(Math.max(middle - off, 0));
  context.strokeStyle = stroke;
  context.lineWidth = 1.5;
  context.beginPath();
  for (let k = 0; k <= 60; k++) {
    const angle = 2 * Math.PI * k / 60, along = large * Math.cos(angle), across = small * Math.sin(angle);
    const x = toX(east + along * Math.cos(turn) - across * Math.sin(turn));
    const y = toY(north + along * Math.sin(turn) + across * Math.cos(turn));
    context[k ? 'lineTo' : 'moveTo'](x, y);
  }
  context.stroke();
}

// A cell of colour, on whole pixels: no grid shows between cells
function cell({context, toX, toY}, x0, x1, y0, y1, [red, green, blue]) {
  context.fillStyle = `rgb(${red}, ${green}, ${blue})`;
  const [left, top] = [Math.round(toX(x0)), Math.round(toY(y1))];
  context.fillRect(left, top, Math.round(toX(x1)) - left, Math.round(toY(y0)) - top);
}

// --- cost surface

function scaled(cost) {
  const above = cost.misfit.map(row => row.map(one => one === null ? null : Math.sqrt(Math.max(0, one - cost.best_misfit))));
  const known = above.flat().filter(one => one !== null).sort((a, b) => a - b);
  return {above, top: Math.max(TOP, known[Math.floor(0.9 * (known.length - 1))] || 0)};
}

function drawCost(canvas, cost) {
  if (!cost?.shifts_m?.length || cost.best_misfit === null) {
    canvas.getContext('2d').clearRect(0, 0, canvas.width, canvas.height);
    return;
  }
  const shifts = cost.shifts_m, step = shifts[1] - shifts[0], reach = shifts[shifts.length - 1] + step / 2;
  const drawn = axes(canvas, {
    x: [-reach, reach], y: [-reach, reach], xLabel: 'shift east (m)', yLabel: 'shift north (m)', equal: true,
  });
  const {above, top} = scaled(cost);
  above.forEach((row, i) => row.forEach((one, k) => {
    const fill = one === null ? [190, 190, 190] : colour(1 - Math.min(one / top, 1));
    cell(drawn, shifts[i] - step / 2, shifts[i] + step / 2, shifts[k] - step / 2, shifts[k] + step / 2, fill);
  }));
  const {context, toX, toY} = drawn;
  cost.minima.slice(0, 5).forEach((one, k) => {
    ring(context, toX(one.shift_m[0]), toY(one.shift_m[1]), k ? 4 : 6, k ? '#CC79A7' : '#ffffff');
    ring(context, toX(one.shift_m[0]), toY(one.shift_m[1]), k ? 5 : 7.5, '#222222');
    if (!k) ellipse(drawn, one.shift_m, one.covariance_m2, '#E69F00');
  });
  context.strokeStyle = '#222222';
  context.lineWidth = 1.5;
  context.beginPath();
  context.moveTo(toX(0) - 8, toY(0));
  context.lineTo(toX(0) + 8, toY(0));
  context.moveTo(toX(0), toY(0) - 8);
  context.lineTo(toX(0), toY(0) + 8);
  context.stroke();
}

function costWords(profile, state) {
  const cost = profile.costs[state];
  if (!cost || cost.best_misfit === null) return `${profile.name}, ${state}: too few shots on the surface.`;
  const [east, north] = cost.minima[0]?.shift_m || [NaN, NaN], {top} = scaled(cost);
  return `${profile.name}, ${state} the adjustment with relief: root of the misfit above the best, from yellow (0) to dark `
    + `blue (${short(top, 2)} or more); grey: too few shots on the surface. Best where the profile is shifted by `
    + `${short(east)} m east and ${short(north)} m north; the cross marks where it is, the ellipse one sigma.`;
}

// --- profiles

function drawHeights(canvas, shots) {
  if (!shots) return;
  const along = shots.along_m.map(one => one / 1000);
  const surface = state => shots.height_m.map((one, k) => {
    const off = shots[`above_surface_${state}_m`][k];
    return one === null || off === null ? null : one - off;
  });
  const y = range([...shots.height_m, ...surface('before'), ...surface('after')]);
  if (!y) return;
  const {context, toX, toY, colours} = axes(canvas, {
    x: range(along, 0.02), y, xLabel: 'along the track (km)', yLabel: 'height above the ellipsoid (m)',
  });
  for (const [state, stroke] of [['before', COLOURS.before], ['after', '#0072B2']]) {
    context.strokeStyle = stroke;
    context.lineWidth = 1.4;
    context.beginPath();
    let begun = false;
    surface(state).forEach((one, k) => {
      if (one === null) return begun = false;
      context[begun ? 'lineTo' : 'moveTo'](toX(along[k]), toY(one));
      return begun = true;
    });
    context.stroke();
  }
  shots.height_m.forEach((one, k) => one !== null && ring(context, toX(along[k]), toY(one), 2.5, colours.ink));
}

function heightWords({name, shots}) {
  if (!shots) return `${name}: no table of its shots beside the record.`;
  const on = shots.on_surface.filter(one => String(one) === 'true').length;
  return `${name}: heights of ${shots.names.length} shots as archived (rings), and of the surface that the images show `
    + `under them, before (orange) and after (blue); ${on} lie on the surface.`;
}

function drawOff(canvas, shots) {
  if (!shots) return;
  const along = shots.along_m.map(one => one / 1000), states = ['before', 'after'];
  const y = range([...states.flatMap(state => shots[`above_surface_${state}_m`]), 1, -1]);
  const {context, toX, toY, colours} = axes(canvas, {
    x: range(along, 0.02), y, xLabel: 'along the track (km)', yLabel: 'shot minus surface (m)',
  });
  context.strokeStyle = colours.ink;
  context.beginPath();
  context.moveTo(toX(along[0]), toY(0));
  context.lineTo(toX(along[along.length - 1]), toY(0));
  context.stroke();
  states.forEach((state, s) => shots[`above_surface_${state}_m`].forEach((one, k) => {
    if (one === null) return;
    const x = toX(along[k]), sigma = shots.sigma_m[k] || 0;
    if (s) {
      context.strokeStyle = '#0072B2';
      context.lineWidth = 1;
      context.beginPath();
      context.moveTo(x, toY(one - sigma));
      context.lineTo(x, toY(one + sigma));
      context.stroke();
      dot(context, x, toY(one), 2.4, '#0072B2');
    } else ring(context, x, toY(one), 3, COLOURS.before);
  }));
}

// --- height maps

function ends(values, both) {
  const known = [values[0], values[values.length - 1]].flat().filter(one => one !== null).map(Math.abs).sort((a, b) => a - b);
  const most = known[Math.floor(0.98 * (known.length - 1))] || 1;
  return both ? [-most, most] : [0, most];
}

function drawCells(canvas, record, values, stage, both) {
  const longitude = unwrapped(record.longitude_deg), latitude = record.latitude_deg;
  const step = of => {
    const every = [...new Set(of.map(one => Math.round(1e9 * one)))].sort((a, b) => a - b).map(one => one / 1e9);
    const gaps = every.slice(1).map((one, k) => one - every[k]).filter(one => one > 1e-9);
    return gaps.length ? Math.min(...gaps) : 0.05;
  };
  const [wide, high] = [step(longitude), step(latitude)];
  const drawn = axes(canvas, {
    x: [Math.min(...longitude) - wide, Math.max(...longitude) + wide],
    y: [Math.min(...latitude) - high, Math.max(...latitude) + high],
    xLabel: 'east longitude (°)', yLabel: 'planetocentric latitude (°)',
  });
  const [, most] = ends(values, both);
  longitude.forEach((x, k) => {
    const value = values[stage][k];
    if (value === null) return;
    const fill = both ? twoSided(value / most) : colour(value / most);
    cell(drawn, x - wide / 2, x + wide / 2, latitude[k] - high / 2, latitude[k] + high / 2, fill);
  });
}

// Longitudes without a jump where the block crosses the meridian of 0
function unwrapped(degrees) {
  const spread = Math.max(...degrees) - Math.min(...degrees);
  return spread > 180 ? degrees.map(one => one > 180 ? one - 360 : one) : degrees;
}

function cellWords(record, values, stage, both, words, name) {
  const [, most] = ends(values, both), total = record.points.reduce((sum, one) => sum + one, 0);
  const scale = both ? `blue below, red above the terrain, ± ${short(most)} m` : `dark 0 m, yellow ${short(most)} m or more`;
  return `${words} of the heights above the terrain model, ${name}: ${total} points in ${record.points.length} cells; ${scale}.`;
}

export function panel(app, element) {
  element.view = new Registration(app, element);
  return element.view;
}
