// The sheet of the selected point: its place and sigmas, every ray with chip, residual and tests; what a person may
// change of it. Each change is stored at once, and the map and this sheet say what it did.

import {Chips} from './chips.js';
import {button, make, short, table} from './plot.js';
import {worst} from './start.js';

export class Sheet {
  constructor(app, element) {
    Object.assign(this, {app, element});
    this.known = make('datalist', {id: 'names-of-points'});
    this.name = make('input', {type: 'text', size: 28, placeholder: 'name of a point, or a part of it'});
    this.name.setAttribute('list', this.known.id);
    this.name.addEventListener('input', () => this.propose());
    const form = make('form', {className: 'tools'}, make('label', {}, 'Point ', this.name), this.known, make('button', {type: 'submit', textContent: 'Show'}));
    form.addEventListener('submit', event => {
      event.preventDefault();
      if (this.name.value.trim()) this.app.select(this.name.value.trim());
    });
    this.body = make('div');
    element.replaceChildren(form, this.body);
    for (const name of ['opened', 'selected']) app.addEventListener(name, () => this.show());
    app.addEventListener('changed', () => this.show());
    this.show();
  }

  get path() {
    return `/api/point?${new URLSearchParams({name: this.app.selection})}`;
  }

  // Names that contain what is typed
  async propose() {
    const part = this.name.value.trim();
    const names = part ? (await this.app.request(`/api/list?${new URLSearchParams({id: part, count: 20})}`).catch(() => ({rows: []}))).rows : [];
    if (part === this.name.value.trim()) this.known.replaceChildren(...names.map(([value]) => make('option', {value})));
  }

  // Without a selected point: the points to look at first
  async offer() {
    const words = make('p', {textContent: 'Select a point on the map, in an image or a list, or name it here. The worst:'});
    this.body.replaceChildren(words);
    const found = await this.app.request('/api/worst').catch(error => { words.textContent = error.message; });
    if (found && !this.app.selection) this.body.append(worst(this.app, found));
  }

  async show() {
    const name = this.app.selection;
    if (!name) {
      if (this.app.scene) this.offer();
      return;
    }
    this.name.value = name;
    let sheet;
    try {
      sheet = await this.app.request(this.path);
    } catch (error) {
      this.body.replaceChildren(make('p', {className: 'caption', textContent: error.message}));
      return;
    }
    if (name !== this.app.selection) return;
    this.sheet = sheet;
    this.draw();
    this.readMore(name);
  }

  // Tests and correlations take longer: they come when they are there
  readMore(name) {
    const {sheet} = this, more = {
      answer: [found => { this.answer.textContent = found.answer.split('\n').slice(1).join('\n'); }, words => { this.answer.textContent = words; }],
      tests: [found => this.showTests(found), words => { this.testWords.textContent = words; }],
      correlations: [found => this.showCorrelations(found), words => this.along.replaceChildren(make('p', {className: 'caption', textContent: words}))],
    };
    for (const [key, [put, fail]] of sheet.adjusted ? Object.entries(more) : [])
      this.app.request(this.path.replace('?', `/${key}?`)).then(found => name === this.app.selection && sheet === this.sheet && put(found), error => name === this.app.selection && fail(error.message));
  }

  draw() {
    const {sheet} = this, parts = [];
    parts.push(make('h2', {textContent: `${sheet.name}: ${sheet.class} point, ${sheet.kind}${sheet.edited ? ', changed by hand' : ''}`}));
    if (sheet.place) {
      const {longitude_deg: east, latitude_deg: north, geodetic_latitude_deg: graphic, height_m: height} = sheet.place;
      const sigmas = sheet.sigmas_m ? `; sigma east ${short(sheet.sigmas_m[0])}, north ${short(sheet.sigmas_m[1])}, up ${short(sheet.sigmas_m[2])} m` : '';
      parts.push(make('p', {textContent: `Longitude ${east.toFixed(6)}° E, latitude ${north.toFixed(6)}° (planetocentric; ${graphic.toFixed(6)}° planetographic), ${height.toFixed(2)} m above the ellipsoid${sigmas}.`}));
    } else parts.push(make('p', {textContent: sheet.rays.length ? 'Nothing determines its place: it needs rays of two images.' : 'No measure of it takes part.'}));
    const wait = sheet.adjusted ? 'computing …' : '';
    parts.push(this.answer = make('pre', {textContent: wait}), this.rays(), this.testWords = make('p', {className: 'caption', textContent: wait && `tests: ${wait}`}), this.setAside(), this.actions(), this.forms = make('div'), this.lastChange());
    parts.push(make('h3', {textContent: 'Points most correlated with it'}), this.along = make('div', {}, make('p', {className: 'caption', textContent: wait || 'known after an adjustment'})));
    this.body.replaceChildren(...parts);
  }

  rays() {
    const head = make('tr');
    for (const [name, unit] of [['chip', ''], ['image', ''], ['line', 'px'], ['sample', 'px'], ['σ', 'px'], ['residual line', 'px'], ['residual sample', 'px'],
      ['redundancy', 'line, sample'], ['w-test', 'line, sample'], ['minimal detectable error', 'px: line, sample'], ['', '']])
      head.append(make('th', {scope: 'col'}, name, unit ? make('small', {textContent: unit}) : ''));
    const body = make('tbody');
    this.cells = new Map();
    this.chips = new Chips(this.app);
    for (const ray of this.sheet.rays) body.append(this.ray(ray));
    const table = make('table', {className: 'rays'}, make('thead', {}, head), body);
    return make('div', {className: 'scroll', tabIndex: 0}, table);
  }

  ray(ray) {
    const number = text => make('td', {className: 'number', textContent: text});
    const chip = make('td', {}, ...(ray.picture ? [this.chips.of(ray)] : []));
    const tests = ['redundancy', 'w', 'detectable_px'].map(() => number('…'));
    this.cells.set(ray.image, tests);
    const act = make('td');
    this.button(act, 'Move', `Move the measure in ${ray.image}`, () => this.moving(ray, act));
    this.button(act, 'Reject', `Take the measure in ${ray.image} out`, () => this.change({kind: 'reject', image: ray.image}));
    const [line, sample] = ray.residual_px || [null, null];
    return make('tr', {}, chip, make('td', {textContent: `${ray.image}${ray.used ? '' : ' (not used)'}`}), number(ray.line.toFixed(2)), number(ray.sample.toFixed(2)),
      number(ray.sigma_px.map(one => short(one)).join(', ')), number(short(line)), number(short(sample)), ...tests, act);
  }

  button(where, textContent, title, act) {
    where.append(button(textContent, act, {title, disabled: !this.app.scene.writable}), ' ');
  }

  moving(ray, where) {
    const form = this.placing(ray, ({line, sample}) => this.change({kind: 'move', image: ray.image, line, sample}), () => this.draw());
    where.replaceChildren(form);
    form.querySelector('input').focus();
  }

  // Line and sample in an image, refined against any other measure where both have pixels; Escape gives it up
  placing(ray, store, cancel) {
    const field = (key, value) => make('input', {type: 'number', step: 'any', required: true, value: value === undefined ? '' : Number(value.toFixed(3)), name: key});
    const line = field('line', ray.line), sample = field('sample', ray.sample);
    const form = make('form', {className: 'placing'}, make('label', {}, 'line ', line), ' ', make('label', {}, 'sample ', sample), ' ', make('button', {type: 'submit', textContent: 'Store'}));
    form.setAttribute('aria-label', `Place in ${ray.image}`);
    let sigma = null;
    for (const other of this.sheet.rays.filter(one => ray.picture && one.image !== ray.image && one.picture)) {
      form.append(' ', button(`Refine against ${other.image}`, async () => {
        try {
          const found = await this.app.request('/api/refine', {
            reference: {image: other.image, line: other.line, sample: other.sample}, image: ray.image, line: Number(line.value), sample: Number(sample.value),
          });
          [line.value, sample.value, sigma] = [found.line.toFixed(3), found.sample.toFixed(3), found.sigma_px];
          this.app.say(found.sentence);
        } catch (error) {
          this.app.say(error.message, 'error');
        }
      }));
    }
    for (const one of [line, sample]) one.addEventListener('input', () => { sigma = null; });
    form.append(' ', button('Cancel', cancel));
    form.addEventListener('keydown', event => { if (event.key === 'Escape') cancel(); });
    form.addEventListener('submit', event => {
      event.preventDefault();
      store({line: Number(line.value), sample: Number(sample.value), ...(sigma ? {sigma_px: sigma} : {})});
    });
    return form;
  }

  // A measure more: in an image without one, at first where the geometry puts the point
  adding() {
    const taken = new Set([...this.sheet.rays, ...this.sheet.set_aside].map(one => one.image));
    const left = this.app.scene.images.filter(one => !taken.has(one.name));
    if (!left.length) return this.app.say('It is measured, or rejected, in every image.', 'error');
    const choice = make('select', {}, ...left.map(one => make('option', {value: one.name, textContent: one.name})));
    const place = make('span');
    const show = async () => {
      const image = left.find(one => one.name === choice.value), ray = {image: image.name, picture: Boolean(image.picture)};
      try {
        const [{record}] = await this.app.request('/api/questions', {projections: [[this.sheet.name, image.name]]});
        [ray.line, ray.sample] = record.line_sample_px.map(one => Number(one.toFixed(2)));
        this.app.say(`Geometry puts ${this.sheet.name} at line ${ray.line}, sample ${ray.sample} of ${image.name}.`);
      } catch (error) {
        this.app.say(error.message, 'error');
      }
      if (choice.value !== image.name) return;
      const form = this.placing(ray, measure => this.change({kind: 'measure', measures: [{image: image.name, ...measure}]}), () => this.forms.replaceChildren());
      place.replaceChildren(form);
      form.querySelector('input').focus();
    };
    choice.addEventListener('change', show);
    this.forms.replaceChildren(make('div', {className: 'tools'}, make('label', {}, 'Measure in ', choice), place));
    return show();
  }

  // What the last change of this session moved, the most moved points first
  lastChange() {
    const found = this.app.last;
    if (!found?.moved?.length) return '';
    const more = found.moved.length > 5 ? ` ${found.moved.length - 5} more moved less.` : '';
    const rows = found.moved.slice(0, 5).map(({name, vector_m: vector, sigmas}) => [button(name, () => this.app.select(name)), ...(vector ? [...vector, sigmas].map(one => short(one)) : ['new', '', '', ''])]);
    return make('div', {className: 'last-change'}, table('What the last change moved', ['point', 'east (m)', 'north (m)', 'up (m)', 'of its sigmas'], rows),
      make('p', {className: 'caption', textContent: found.sentences.join(' ') + more}));
  }

  setAside() {
    const aside = this.sheet.set_aside;
    if (!aside.length) return '';
    const list = make('ul');
    for (const one of aside) {
      const item = make('li', {}, `${one.image}: line ${one.line.toFixed(2)}, sample ${one.sample.toFixed(2)} `);
      this.button(item, 'Accept', `Take the measure in ${one.image} in again`, () => this.change({kind: 'accept', image: one.image}));
      list.append(item);
    }
    return make('div', {}, make('h3', {textContent: 'Measures rejected by hand'}), list);
  }

  actions() {
    const box = make('div', {className: 'tools'}), {sheet} = this;
    this.button(box, 'Measure in …', 'Measure it in one more image', () => this.adding());
    if (sheet.class === 'laser' || sheet.class === 'post') return this.last(box);
    if (sheet.kind === 'free') this.button(box, 'Hold …', 'Hold it at a known place, as ground control', () => this.holding());
    else this.button(box, 'Release', 'Hold it no longer', () => this.change({kind: 'release'}));
    this.button(box, 'Take it out', 'Take the point out with all of its measures', () => this.change({kind: 'remove'}));
    return this.last(box);
  }

  // What every point has behind its changes
  last(box) {
    const {sheet} = this;
    box.append(button('See it in the images', () => this.app.look({kind: 'point', name: sheet.name}, 'images')));
    const {kind, lock} = this.app.scene;
    if (kind !== 'project' || lock) box.append(make('span', {className: 'caption', textContent: lock || 'Only a project can be changed.'}));
    return box;
  }

  holding() {
    const known = this.sheet.place, place = key => (known ? Number(known[key].toFixed(key === 'height_m' ? 3 : 8)) : '');
    const field = (key, words, value) => {
      const input = make('input', {type: 'number', step: 'any', value, required: true});
      input.dataset.key = key;
      return make('label', {}, `${words} `, input);
    };
    const form = make('form', {className: 'tools holding'},
      field('longitude_deg', 'longitude (deg E)', place('longitude_deg')), field('geodetic_latitude_deg', 'latitude (deg, planetographic)', place('geodetic_latitude_deg')),
      field('height_m', 'height above the ellipsoid (m)', place('height_m')), field('sigma_east_m', 'σ east (m)', 10), field('sigma_north_m', 'σ north (m)', 10),
      field('sigma_up_m', 'σ up (m)', 10), make('button', {type: 'submit', textContent: 'Hold it there'}));
    form.noValidate = true;
    form.addEventListener('submit', event => {
      event.preventDefault();
      const empty = [...form.querySelectorAll('input')].find(one => one.value === '');
      if (empty) return this.app.say(`Fill in: ${empty.parentElement.textContent.trim()}.`, 'error');
      return this.change({kind: 'hold', ...Object.fromEntries([...form.querySelectorAll('input')].map(one => [one.dataset.key, Number(one.value)]))});
    });
    form.setAttribute('aria-label', `Hold ${this.sheet.name}`);
    form.addEventListener('keydown', event => { if (event.key === 'Escape') this.forms.replaceChildren(); });
    this.forms.replaceChildren(form);
    form.querySelector('input').focus();
  }

  change(body) {
    return this.app.tryTo({point: this.sheet.name, ...body});
  }

  showTests({critical, alpha, rays}) {
    for (const [image, cells] of this.cells)
      ['redundancy', 'w', 'detectable_px'].forEach((key, k) => {
        const values = rays[image]?.[key] || [];
        cells[k].replaceChildren(...values.flatMap((one, n) => {
          const alarm = key === 'w' && one !== null && Math.abs(one) > critical;
          return [...(n ? [', '] : []), make('span', {className: alarm ? 'alarm' : '', textContent: short(one)})];
        }), ...(values.length ? [] : ['–']));
      });
    this.testWords.textContent = `A measure is suspected where |w| exceeds ${short(critical)} (a false alarm in ${short(1 / alpha, 4)}); the minimal detectable error is the smallest that would be found with a probability of 80 %.`;
  }

  showCorrelations({axes, rows, distance_m: away, looked_at: count}) {
    if (!rows.length) return this.along.replaceChildren(make('p', {className: 'caption', textContent: 'No other point with a place.'}));
    const of = ({name, correlation}) => [button(name, () => this.app.select(name)), short(away[name]), ...correlation.map(one => one.toFixed(3).replace('-', '−'))];
    return this.along.replaceChildren(table('', ['point', 'distance (m)', ...axes], rows.map(of)),
      make('p', {className: 'caption', textContent: `Of ${count} points that its images show, those whose coordinates are most correlated with its own: 1 = fully correlated errors.`}));
  }
}

export function panel(app, element) {
  element.view = new Sheet(app, element);
  return element.view;
}
