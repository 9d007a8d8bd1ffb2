/* the more serious of two statuses */
static @name@_status @name@_worse(const @name@_status a, const @name@_status b)
{
    return (a > b) ? a : b;
}

/* 1 where every value is finite */
static uint32_t @name@_all_finite(const @name@_real *const v, const uint32_t count)
{
    @name@_real wrong = @0@;
    uint32_t i;
    for (i = 0U; i < count; i++)
    {
        wrong = wrong + (v[i] - v[i]);
    }
    return (wrong >= @0@) ? 1U : 0U;
}

/* the largest magnitude */
static @name@_real @name@_largest(const @name@_real v[@NAME@_JOINTS])
{
    @name@_real most = @0@;
    uint32_t i;
    for (i = 0U; i < @NAME@_JOINTS; i++)
    {
        const @name@_real magnitude = (v[i] < @0@) ? -v[i] : v[i];
        most = (magnitude > most) ? magnitude : most;
    }
    return most;
}

/* v scaled so that no joint is beyond the limit; 1 where that was needed */
static uint32_t @name@_limited(@name@_real v[@NAME@_JOINTS], const @name@_real limit)
{
    const @name@_real most = @name@_largest(v);
    const @name@_real scale = limit / ((most > limit) ? most : limit);
    uint32_t i;
    for (i = 0U; i < @NAME@_JOINTS; i++)
    {
        const @name@_real scaled = v[i] * scale;
        const @name@_real low = (scaled > -limit) ? scaled : -limit;
        v[i] = (low < limit) ? low : limit;
    }
    return (most > limit) ? 1U : 0U;
}

@name@_status @name@_forward(const @name@_real q[@NAME@_JOINTS], @name@_real p[@n_p@])
{
    @name@_status status;
    if ((q == NULL) || (p == NULL))
    {
        status = @NAME@_NULL_ARG;
    }
    else
    {
        static const @name@_real box[2][@NAME@_JOINTS] = @box_table:reach@;
        @name@_real x[@NAME@_JOINTS];
        uint32_t fine;
        status = @name@_boxed(q, box, x);
        fine = @name@_forward_values(x, p);
        fine = fine & @name@_all_finite(p, @n_p@U);
        if ((fine == 0U) || (status == @NAME@_NOT_FINITE))
        {
            uint32_t i;
            for (i = 0U; i < @n_p@U; i++)
            {
                p[i] = @0@;
            }
            status = @NAME@_NOT_FINITE;
        }
    }
    return status;
}

/* the correction at joints x inside the box */
static @name@_status @name@_chord(const @name@_real x[@NAME@_JOINTS], @name@_real dq[@NAME@_JOINTS])
{
    @name@_status status = @NAME@_OK;
    @name@_real work[@n_work@]; /* what prepare gives; where the calibrated robot is comes last */
    @name@_real at[@n@];
    @name@_real moved[@n_moved@]; /* joint step, squared error before it */
    @name@_real before = @largest@;
    @name@_real wrong = @0@;
    uint32_t clamped = 0U;
    uint32_t fine = @name@_prepare_values(x, work);
    uint32_t step;
    uint32_t i;
    for (i = 0U; i < @NAME@_JOINTS; i++)
    {
        dq[i] = @0@;
        moved[i] = @0@;
    }
    moved[@i_error@] = @0@;
    for (step = 0U; step <= @steps@U; step++)
    {
        if (step > 0U)
        {
            before = moved[@i_error@];
            for (i = 0U; i < @NAME@_JOINTS; i++)
            {
                at[i] = x[i] + dq[i];
            }
            fine = fine & @name@_forward_values(at, &work[@n_prepared@]);
        }
        fine = fine & @name@_advance_values(work, moved);
        wrong = wrong + (moved[@i_error@] - moved[@i_error@]);
        clamped = @name@_limited(moved, @limit_step@);
        for (i = 0U; i < @NAME@_JOINTS; i++)
        {
            moved[i] = dq[i] + moved[i];
        }
        clamped = clamped | (@name@_limited(moved, @NAME@_DELTA_LIMIT) << 1U);
        /* the evaluation after the last step gives one more, where that one reduced the error to a third or less */
        for (i = 0U; i < @NAME@_JOINTS; i++)
        {
            dq[i] = ((step < @steps@U) || ((@9@ * moved[@i_error@]) <= before)) ? moved[i] : dq[i];
        }
    }
    wrong = wrong + (work[@i_weakness@] - work[@i_weakness@]);
    if ((fine == 0U) || !(wrong >= @0@))
    {
        for (i = 0U; i < @NAME@_JOINTS; i++)
        {
            dq[i] = @0@;
        }
        status = @NAME@_NOT_FINITE;
    }
    else if (work[@i_weakness@] > @limit_weakness@)
    {
        status = @NAME@_SINGULAR;
    }
    else if ((clamped & 2U) != 0U)
    {
        status = @NAME@_LIMITED;
    }
    else if ((clamped != 0U) || (moved[@i_error@] > @limit_tolerance2@))
    {
        status = @NAME@_NOT_CONVERGED;
    }
    else
    {
        /* where the nominal model is, within the tolerance */
    }
    return status;
}

/* the correction at any joints */
static @name@_status @name@_corrected(const @name@_real q[@NAME@_JOINTS], @name@_real dq[@NAME@_JOINTS])
{
    static const @name@_real box[2][@NAME@_JOINTS] = @box_table:command@;
    @name@_real x[@NAME@_JOINTS];
    @name@_status status = @name@_boxed(q, box, x);
    if (status == @NAME@_NOT_FINITE)
    {
        uint32_t i;
        for (i = 0U; i < @NAME@_JOINTS; i++)
        {
            dq[i] = @0@;
        }
    }
    else
    {
        status = @name@_worse(status, @name@_chord(x, dq));
    }
    return status;
}

@name@_status @name@_correct(const @name@_real q[@NAME@_JOINTS], @name@_real dq[@NAME@_JOINTS])
{
    return ((q == NULL) || (dq == NULL)) ? @NAME@_NULL_ARG : @name@_corrected(q, dq);
}

@name@_status @name@_step(@name@_state *state, const @name@_real q[@NAME@_JOINTS], uint32_t enable, @name@_real dq[@NAME@_JOINTS])
{
    @name@_status status;
    if ((state == NULL) || (q == NULL) || (dq == NULL))
    {
        status = @NAME@_NULL_ARG;
    }
    else
    {
        @name@_real want[@NAME@_JOINTS];
        @name@_real gain = state->gain;
        uint32_t i;
        status = @name@_corrected(q, want);
        if (!((@name@_all_finite(state->dq, @n@U) != 0U) && (@name@_largest(state->dq) <= @NAME@_DELTA_LIMIT)
              && (gain >= @0@) && (gain <= @1@)))
        {
            for (i = 0U; i < @NAME@_JOINTS; i++)
            {
                state->dq[i] = @0@;
            }
            gain = @0@;
            status = @NAME@_NOT_FINITE;
        }
        gain = gain + ((enable != 0U) ? @limit_ramp@ : -@limit_ramp@);
        gain = (gain > @0@) ? gain : @0@;
        gain = (gain < @1@) ? gain : @1@;
        state->gain = gain;
        for (i = 0U; i < @NAME@_JOINTS; i++)
        {
            const @name@_real change = (gain * want[i]) - state->dq[i];
            @name@_real given = change;
            if (change > @NAME@_CHANGE_LIMIT)
            {
                given = @NAME@_CHANGE_LIMIT;
                status = @name@_worse(status, @NAME@_RATE_LIMITED);
            }
            if (change < -@NAME@_CHANGE_LIMIT)
            {
                given = -@NAME@_CHANGE_LIMIT;
                status = @name@_worse(status, @NAME@_RATE_LIMITED);
            }
            given = state->dq[i] + given;
            given = (given > -@NAME@_DELTA_LIMIT) ? given : -@NAME@_DELTA_LIMIT;
            given = (given < @NAME@_DELTA_LIMIT) ? given : @NAME@_DELTA_LIMIT;
            state->dq[i] = given;
            dq[i] = given;
        }
    }
    return status;
}

