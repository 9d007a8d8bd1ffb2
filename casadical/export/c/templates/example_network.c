    {
        @name@_real @out@[@n_out@];
        status = @name@_@function@(q, @out@);
        (void)printf("@function@, status %d:", (int)status);
        for (i = 0U; i < @n_out@U; i++)
        {
            (void)printf(" %.9g @unit@", (double)@out@[i]);
        }
        (void)printf("\n");
    }
