/* The samples that a communication step of a controller covers; included by core.c. Python FMUs have the same
   arithmetic in ticks.py. */

static double sampling_time(const State *s) { return s->v[PARAMETER_T_S]; }
/* The time of the next sample, for the equations. */
static double sample_time(const State *s) { return s->start + (double)s->sample * sampling_time(s); }
/* Time on the importer's clock of the next sampling instant, or of the one n instants later. */
static double instant_ahead(const State *s, double n) { return s->origin + ((double)s->sample + n) * sampling_time(s); }
static double sampling_instant(const State *s) { return instant_ahead(s, 0.0); }
/* Largest difference of two times that count as the same sampling instant: 1e-6 of T_s and the rounding of the time. It
   is at most a quarter of T_s, so that no time belongs to two instants. */
static double same_instant(const State *s) {
    const double rounding = 1e-6 * sampling_time(s) + 8.0 * DBL_EPSILON * fabs(s->time);
    return rounding < 0.25 * sampling_time(s) ? rounding : 0.25 * sampling_time(s);
}

static int at_sampling_instant(const State *s) {
    if (s->per_sample > 0.0) return s->ahead <= SAME_TICK;
    return fabs(s->time - sampling_instant(s)) <= same_instant(s);
}

/* The simplest fraction step/T_s that is right to within ``slack`` (s): the first such convergent of the continued
   fraction. The denominator is limited, so that a ratio chosen at random has such a fraction in less than 1 of 100
   cases; without a fraction per_sample is 0. */
static Fraction fraction_of(double step, double T_s, double slack) {
    const double most = fmin(MOST_PER_SAMPLE, sqrt(0.01 * T_s / slack));
    Fraction found = {step, 0.0, 0.0};
    double rest = step / T_s, p = 1.0, p_last = 0.0, q = 0.0, q_last = 1.0;
    for (;;) {
        const double whole = floor(rest), p_next = whole * p + p_last, q_next = whole * q + q_last;
        if (!(p_next <= MOST_TICKS && q_next <= most)) return found; /* also for NaN */
        p_last = p;
        p = p_next;
        q_last = q;
        q = q_next;
        if (p >= 1.0 && fabs(p * T_s - q * step) <= q * slack) {
            found.ticks = p;
            found.per_sample = q;
            return found;
        }
        rest = 1.0 / (rest - whole);
    }
}

static double whole_if_near(double number, double slack) {
    const double whole = floor(number + 0.5);
    return fabs(number - whole) <= slack ? whole : number;
}

/* Move the count of ticks to the beginning of a step. An importer may add up its time, t += h: in a long run the sum
   drifts from k*h by many samples. So if step and T_s have a simple ratio, ticks decide which samples are due, and the
   sampling instants move with the importer's clock. Otherwise the time decides. */
static void count_ticks(State *s, double step, double end) {
    const double T_s = sampling_time(s);
    if (step != s->fraction.step || (s->fraction.per_sample == 0.0 && end - s->time == step)) {
        /* the difference of two times is only as exact as the times are */
        const double rounding = end - s->time == step ? 2.0 * fabs(end) : 0.0;
        s->fraction = fraction_of(step, T_s, DBL_EPSILON * (32.0 * step + rounding));
    }
    if (s->per_sample > 0.0) {
        const double left = s->ahead > 0.0 ? s->ahead / s->per_sample * T_s : 0.0;
        const double drift = s->time + left - sampling_instant(s);
        if (fabs(drift) > 0.5 * same_instant(s)) s->origin += drift;
    }
    if (s->fraction.per_sample != s->per_sample) {
        const double n = s->fraction.per_sample;
        if (s->per_sample > 0.0)
            s->ahead = whole_if_near(s->ahead / s->per_sample * n, SAME_TICK);
        else
            s->ahead = fmax(0.0, whole_if_near((sampling_instant(s) - s->time) / T_s * n, same_instant(s) / T_s * n));
        s->per_sample = n;
    }
}

/* The number of samples of the step to ``end``. A sample at its beginning counts, a sample at its end does not. */
static double samples_due(const State *s, double end) {
    double last, n;
    if (s->per_sample > 0.0) {
        const double left = s->fraction.ticks - SAME_TICK - s->ahead;
        if (left < s->per_sample) return left > 0.0 ? 1.0 : 0.0; /* the usual case, without a division */
        return (double)(long)(left / s->per_sample) + 1.0;
    }
    last = end - same_instant(s);
    n = fmax(0.0, ceil((last - sampling_instant(s)) / sampling_time(s)));
    if (n > MAX_SAMPLES) return n;
    while (n > 0.0 && instant_ahead(s, n - 1.0) >= last) n -= 1.0;
    while (instant_ahead(s, n) < last) n += 1.0;
    return n;
}
