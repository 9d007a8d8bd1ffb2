    {
        /* In a controller: one state per arm, one call per cycle, q the commanded joints, q + dq sent to the drives. */
        @name@_state state = { { @zeros@ }, @0@ };
        @name@_real dq[@NAME@_JOINTS];
        uint32_t cycle;
        for (cycle = 0U; cycle < @all_cycles@U; cycle++)
        {
            status = @name@_step(&state, q, 1U, dq);
        }
        (void)printf("correction after %u cycles, status %d:", (unsigned int)cycle, (int)status);
        for (i = 0U; i < @NAME@_JOINTS; i++)
        {
            (void)printf(" %.9g", (double)dq[i]);
        }
        (void)printf("\n");
    }
