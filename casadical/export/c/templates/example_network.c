    {
        @name@_real dp_mm[@n_dp@];
        status = @name@_network(q, dp_mm);
        (void)printf("network, status %d:", (int)status);
        for (i = 0U; i < @n_dp@U; i++)
        {
            (void)printf(" %.9g mm", (double)dp_mm[i]);
        }
        (void)printf("\n");
    }
